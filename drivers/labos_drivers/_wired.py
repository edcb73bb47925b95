"""Devices at the end of a wire: blocking commands, called off the event loop.

A driver is a subclass of ``Wired`` whose methods block; those that a node calls are marked
``@off_loop`` and become awaitable. They run one after the other in one thread, so a device is never
asked two things at once, and the node's loop never waits for a wire.
"""

from __future__ import annotations

import asyncio
import functools
import threading
import time
from collections.abc import Awaitable, Callable, Coroutine, Iterator
from contextlib import contextmanager, suppress
from typing import Any, ClassVar, Concatenate, ParamSpec, TypeAlias, TypeVar

from labos.errors import DeviceError, LinkError, WrongDevice
from labos.link.life import Life
from labos.node import Setup, see_unit, under_way
from labos.node.torture import WiredDevice
from labos.node.worker import Worker
from labos_drivers._limits import read_deadlines
from labos_drivers._refusals import Refusing, make_refusal
from labos_drivers._simulation import Instrument, Simulated

D = TypeVar("D", bound="Wired")
P = ParamSpec("P")
T = TypeVar("T")

CLOSE_S = 1.0

DeviceOnWire: TypeAlias = WiredDevice
"""A simulated device behind a wire."""


def off_loop(
    method: Callable[Concatenate[D, P], T],
) -> Callable[Concatenate[D, P], Coroutine[Any, Any, T]]:
    """Make a blocking method awaitable: it runs in the driver's thread."""
    return _run_in("run", method)


def during_motion(
    method: Callable[Concatenate[D, P], T],
) -> Callable[Concatenate[D, P], Coroutine[Any, Any, T]]:
    """Make a blocking question awaitable: it runs in a thread of its own, and does not wait for the end of a
    motion."""
    return _run_in("ask", method)


def _run_in(
    worker: str, method: Callable[Concatenate[D, P], T]
) -> Callable[Concatenate[D, P], Coroutine[Any, Any, T]]:
    @functools.wraps(method)
    async def call(self: D, /, *args: P.args, **kwargs: P.kwargs) -> T:
        result: T = await getattr(self, worker)(functools.partial(method, self, *args, **kwargs))
        return result

    return call


class Wired(Refusing):
    """Base of drivers, which set ``link``, to the ``address`` of their device. ``simulator`` is the simulated
    device behind the wire, if there is one; ``where`` is the key of the workcell file that names a real one,
    with an example; ``deadlines`` are those that the file may set."""

    where: ClassVar[tuple[str, str]] = ("port", "/dev/ttyUSB0")
    deadlines: ClassVar[tuple[str, ...]] = ()
    link: Life
    under_way = staticmethod(under_way)

    def __init__(self, setup: Setup, address: str, simulator: DeviceOnWire | None = None) -> None:
        self.name = setup.name
        self._setup = setup
        self._deadlines = read_deadlines(setup, self.deadlines)
        self.run = Worker(f"{setup.name} driver")
        self.ask = Worker(f"{setup.name} questions")
        self.moving = False
        self._simulator = simulator
        self._halted = threading.Event()

    def limit_s(self, deadline: str, usual_s: float) -> float:
        """How long something may take (s): as ``deadlines:`` of the config says, else as usual."""
        assert deadline in self.deadlines, deadline
        return self._deadlines.get(deadline, usual_s)

    def see_unit(self, serial: Any) -> None:
        """Report the device's serial number, when it is recognised. Raises WrongDevice."""
        see_unit(self._setup, serial)

    def note_firmware(self, version: Any) -> None:
        """Note the device's version, when it is recognised."""
        self._setup.firmware = str(version or "").strip()

    @off_loop
    def connect(self) -> None:
        """Find the device; nothing moves. Raises NotConnected, WrongDevice."""
        self.link.open()

    def disconnect(self) -> None:
        """Close the connection."""
        self.link.close()

    async def stop(self) -> None:
        """Send nothing more until a reset. A device without a stop command ends what it has begun. Raises
        DeviceError then, so that whoever stopped it knows."""
        self._halted.set()
        if self.moving:
            raise DeviceError(
                f"{self.name} takes no stop over its wire; it ends what it has begun.",
                remedy="Use the button or switch on the device.",
            )

    async def close(self) -> None:
        """Close the connection. A question that is under way in the driver's thread keeps it open, and must
        not keep the node from ending."""
        with suppress(TimeoutError):
            await asyncio.wait_for(self.ask(self.disconnect), CLOSE_S)
        self.run.close()
        self.ask.close()
        if self._simulator is not None:
            self._simulator.close()

    def is_idle(self) -> Awaitable[bool]:
        """Whether the device stands still. Raises DeviceError."""
        raise NotImplementedError

    def reset(self) -> Awaitable[None]:
        """Bring the device out of an error, and end a stop. Raises DeviceError."""
        raise NotImplementedError

    def observe(self) -> Awaitable[dict[str, Any]]:
        """What the device's own sensors see, in the form of ``Node.observe``."""
        raise NotImplementedError

    def trouble(self) -> Awaitable[str]:
        """What the device says is wrong now; empty if nothing is."""
        raise NotImplementedError

    def follow(self, handle: str) -> Awaitable[Any]:
        """The end of what was noted under this handle before; nothing is started. Raises DeviceError,
        OutcomeUnknown."""
        raise NotImplementedError

    def check_not_stopped(self, effects: str = "none") -> None:
        """Raise DeviceError if the device was stopped; called before each command that moves."""
        if self._halted.is_set():
            raise DeviceError(f"{self.name} was stopped.", effects=effects, remedy="Reset it.")

    def resume(self) -> None:
        """A reset ends a stop."""
        self._halted.clear()

    @staticmethod
    def ask_again(ask: Callable[[], T], limit_s: float, pause_s: float) -> T:
        """Ask a device that goes on by itself; while it cannot be reached, it is asked again for so long.
        Raises LinkError."""
        deadline = time.monotonic() + limit_s
        while True:
            try:
                return ask()
            except WrongDevice:
                raise
            except LinkError:
                if time.monotonic() > deadline:
                    raise
            time.sleep(pause_s)

    @contextmanager
    def report_no_effects(self) -> Iterator[None]:
        """For questions before a motion: an error in them is reported with the effects ``none``."""
        try:
            yield
        except DeviceError as error:
            error.effects = "none"
            raise

    @contextmanager
    def motion(self) -> Iterator[None]:
        """The device is at work."""
        self.check_not_stopped()
        self.moving = True
        try:
            yield
        finally:
            self.moving = False


class OnBenchOrWire(Instrument):
    """A node whose device is simulated on the bench, simulated behind its wire, or real; ``devices``
    says as what. ``follows`` are the actions whose end the driver finds out by a handle after a restart."""

    devices: ClassVar[tuple[Callable[[Setup], Simulated], Callable[[Setup], DeviceOnWire], type[Wired]]]
    follows: ClassVar[tuple[str, ...]] = ()
    not_started: ClassVar[str] = "nothing was started"

    async def connect(self) -> None:
        on_bench, behind_wire, driver = self.devices
        if self.setup.world is None:
            device = driver(self.setup, find_address(self.setup, *driver.where), None)
        elif not self.setup.wire:
            self.device = on_bench(self.setup)
            return
        else:
            simulator = behind_wire(self.setup)
            simulator.start()
            device = driver(self.setup, simulator.address, simulator)
        try:
            await device.connect()
        except BaseException:
            await device.close()
            raise
        self.device = device

    async def take_up(self, name: str, handle: str) -> Any:
        if name not in self.follows or not isinstance(self.device, Wired):
            return await super().take_up(name, handle)
        if not handle:
            raise make_refusal(self.setup.name, self.not_started)
        return await self.device.follow(handle)


class ReportsTrouble(OnBenchOrWire):
    """A node whose driver asks its device for ``trouble``. It tells what the device said both now and before,
    so that what flickers is not told. A line that is lost is told by whatever is asked next."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._reported = self._said_before = ""

    async def trouble(self) -> str:
        if not isinstance(self.device, Wired):
            return ""
        try:
            now = await self.device.trouble()
        except DeviceError:
            return self._reported
        self._reported, self._said_before = (now if now == self._said_before else ""), now
        return self._reported


def find_address(setup: Setup, key: str, example: str) -> str:
    """The address of the module's device, from the workcell file. Raises DeviceError."""
    address = setup.config.get(key)
    if not isinstance(address, str) or not address:
        raise make_refusal(
            setup.name,
            f"the workcell names no {key} for this device",
            f"Write `config: {{{key}: {example}}}` for the module, or start with --simulate.",
        )
    return address


def parse_host_port(address: str, port: int) -> tuple[str, int]:
    """Host and port of ``host``, ``host:port`` or a URL of them; ``port`` if it names none. Raises
    DeviceError."""
    host, colon, digits = address.rpartition("//")[2].partition(":")
    if colon and not digits.isdecimal():
        raise DeviceError(
            f"{address!r} is no address.", effects="none", remedy="Write it as host or as host:port."
        )
    return host, int(digits) if colon else port
