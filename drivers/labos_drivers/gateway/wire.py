"""A simulated instrument behind the real reference gateway."""

from __future__ import annotations

import asyncio
import tempfile
import threading
from collections.abc import Awaitable, Callable, Collection, Mapping
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from labos.node import Crash, DeviceError, Setup, World
from labos_drivers._simulation import Simulated
from labos_drivers.gateway.server import Failed, Gateway, Hands, Server, Unknown

D = TypeVar("D", bound=Simulated)


class SimulatedHands(Hands):
    """Hands with a simulated device instead of the maker's software. The device runs in its own thread."""

    def __init__(
        self,
        instrument: str,
        device: Simulated,
        actions: Mapping[str, Callable[..., Awaitable[Any]]],
        sensors_after: Mapping[str, dict[str, Any]],
        leave_files: Collection[str],
    ) -> None:
        self.instrument, self.actions = instrument, tuple(actions)
        self._sensors_after, self._leave_files = sensors_after, leave_files
        self.fails_with = ""
        """The next action ends so, after all that it did."""
        self.serial_number, self.firmware_version = f"{instrument}-2041", "1.7"
        self._device, self._actions = device, actions
        self._is_at_work = False
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()

    def serial(self) -> str:
        return self.serial_number

    def firmware(self) -> str:
        return self.firmware_version

    def do(self, action: str, args: dict[str, Any], folder: Path) -> Any:
        async def work() -> Any:
            if action == "reset":
                self._device.reset()
                return None
            return await self._actions[action](**args)

        self._is_at_work = True
        try:
            result = asyncio.run_coroutine_threadsafe(work(), self._loop).result()
            if action in self._leave_files:
                (folder / str(result)).write_text("made by its own software\n")
        except DeviceError as error:
            raise Failed(error.message, error.remedy, error.effects) from error
        except Crash as error:
            raise Failed(str(error)) from error
        finally:
            self._is_at_work = False
        if self.fails_with:
            why, self.fails_with = self.fails_with, ""
            raise Failed(why)
        return result

    def look_back(self, action: str, folder: Path) -> Any:
        """The result of an action: the name of the one file that it left. Without such a file, None if the
        sensors report the values that they have after the action. Otherwise raises Unknown."""
        files = [path.name for path in folder.iterdir()] if action in self._leave_files else []
        if len(files) == 1:
            return files[0]
        wanted = self._sensors_after.get(action)
        if wanted and self.read_sensors() == wanted:
            return None
        raise Unknown(f"the gateway was restarted in mid-action, and nothing shows what became of {action}")

    def is_idle(self) -> bool:
        return not self._is_at_work and self._device.is_idle()

    def read_sensors(self) -> dict[str, Any]:
        return self._device.observe()

    def stop(self) -> bool:
        self._loop.call_soon_threadsafe(self._device.stop)
        return True

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5)
        self._loop.close()


class GatewayOnWire(Generic[D]):
    """The gateway with a simulated device of class ``kind``. ``actions`` maps the instrument's actions to the
    device's methods. ``sensors_after`` has the values of its sensors after some actions. ``leave_files`` has
    the actions whose result is the name of a file. The journal is in ``folder`` if given, else beside the
    bench, where it survives a power loss. With a bench in memory it is in a temporary folder."""

    instrument: ClassVar[str]
    kind: Callable[[Setup], D]
    actions: ClassVar[Mapping[str, str]]
    sensors_after: ClassVar[Mapping[str, dict[str, Any]]] = {}
    leave_files: ClassVar[Collection[str]] = ()

    def __init__(self, setup: Setup, folder: Path | None = None) -> None:
        self.device: D = type(self).kind(setup)
        folder = folder or _find_folder(self.device.world, setup.name)
        self._temporary = tempfile.TemporaryDirectory(prefix="labos-gateway-") if folder is None else None
        self._folder = Path(self._temporary.name) if self._temporary else Path(str(folder))
        methods = {name: getattr(self.device, method) for name, method in self.actions.items()}
        self.hands = SimulatedHands(
            self.instrument, self.device, methods, self.sensors_after, self.leave_files
        )
        self._port = 0
        self._server: Server | None = None
        self._gateway = self._boot()
        self.plug()

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self._port}"

    @property
    def serial(self) -> str:
        return self.hands.serial_number

    @serial.setter
    def serial(self, number: str) -> None:
        self.hands.serial_number = number

    def plug(self) -> None:
        """Open the gateway's port. The port stays the same after ``unplug``."""
        if self._server is None:
            self._server = Server(self._gateway, port=self._port)
            self._port = self._server.server_port

    def start(self) -> None:
        server = self._server
        if server is not None:
            threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()

    def restart_pc(self) -> None:
        """End the gateway and start it again. The instrument continues its action meanwhile."""
        self.unplug()
        self._gateway.close()
        self._gateway = self._boot()
        self.plug()
        self.start()

    def _boot(self) -> Gateway:
        return Gateway(self.hands, self._folder / "journal.jsonl")

    def unplug(self) -> None:
        server, self._server = self._server, None
        if server is not None:
            server.shutdown()
            server.server_close()

    def close(self) -> None:
        self.unplug()
        self._gateway.close()
        self.hands.close()
        if self._temporary is not None:
            self._temporary.cleanup()


def _find_folder(world: World, name: str) -> Path | None:
    """The folder that is the disk of a device's PC, beside the bench; None for a bench in memory."""
    return None if world.path == ":memory:" else Path(f"{world.path}.{name}.pc")
