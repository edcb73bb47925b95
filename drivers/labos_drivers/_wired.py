"""Drivers of devices at the end of a wire: blocking methods, which do not run on the event loop.

A driver is a subclass of ``Wired`` with blocking methods. Those that a node calls are marked ``@off_loop``,
which makes them awaitable. They run one after the other in one thread. So a device never gets two commands
at once, and the node's loop never waits for a wire.
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
from labos.node import Setup, assume_motion, check_unit
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
    """Make a blocking method awaitable. It runs in the driver's thread."""
    return _run_in("run", method)


def during_motion(
    method: Callable[Concatenate[D, P], T],
) -> Callable[Concatenate[D, P], Coroutine[Any, Any, T]]:
    """Make a blocking question awaitable. It runs in the driver's second thread, so it does not wait for the
    end of a motion."""
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
    """Base of drivers. A subclass sets ``link``, which leads to the ``address`` of its device. ``simulator``
    is the simulated device behind the wire, if there is one. ``where`` is the key in the workcell file for
    the address of a real device, with an example. ``deadlines`` are the time limits that the file may set."""

    where: ClassVar[tuple[str, str]] = ("port", "/dev/ttyUSB0")
    deadlines: ClassVar[tuple[str, ...]] = ()
    link: Life
    assume_motion = staticmethod(assume_motion)

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
        """The time limit with this name (s): from ``deadlines:`` of the config, else ``usual_s``."""
        assert deadline in self.deadlines, deadline
        return self._deadlines.get(deadline, usual_s)

    def check_unit(self, serial: Any) -> None:
        """Check the serial number that the device has reported; called at each connection. Raises
        WrongDevice, NotConnected."""
        check_unit(self._setup, serial)

    def note_firmware(self, version: Any) -> None:
        """Store the firmware version that the device has reported; called at each connection."""
        self._setup.firmware = str(version or "").strip()

    @off_loop
    def connect(self) -> None:
        """Connect to the device; nothing moves. Raises NotConnected, WrongDevice."""
        self.link.open()

    def disconnect(self) -> None:
        """Close the connection."""
        self.link.close()

    async def stop(self) -> None:
        """Send no further command that moves until a reset. A device without a stop command completes a
        motion in progress. Raises DeviceError then, so that the person who stopped it knows."""
        self._halted.set()
        if self.moving:
            raise DeviceError(
                f"{self.name} takes no stop over its wire; it ends what it has begun.",
                remedy="Use the button or switch on the device.",
            )

    async def close(self) -> None:
        """Close the connection. A call that still waits for the device keeps it open. This method waits
        for it only for ``CLOSE_S``, so that the node can end."""
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
        """The readings of the device's own sensors, in the form of ``Node.observe``."""
        raise NotImplementedError

    def trouble(self) -> Awaitable[str]:
        """The present error that the device reports; empty if there is none."""
        raise NotImplementedError

    def follow(self, handle: str) -> Awaitable[Any]:
        """Wait for the end of the action that was journalled with this handle; returns its result. Nothing is
        started. Raises DeviceError, OutcomeUnknown."""
        raise NotImplementedError

    def check_not_stopped(self, effects: str = "none") -> None:
        """Check that the device was not stopped, before each command that moves. Raises DeviceError."""
        if self._halted.is_set():
            raise DeviceError(f"{self.name} was stopped.", effects=effects, remedy="Reset it.")

    def resume(self) -> None:
        """End a stop; a reset calls this."""
        self._halted.clear()

    @staticmethod
    def ask_again(ask: Callable[[], T], limit_s: float, pause_s: float) -> T:
        """The answer of a device that continues by itself. While the link fails, it is asked again, but no
        longer than ``limit_s``. Raises LinkError after that, and WrongDevice at once."""
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
        """For questions before a motion: their errors are reported with the effects ``none``."""
        try:
            yield
        except DeviceError as error:
            error.effects = "none"
            raise

    @contextmanager
    def motion(self) -> Iterator[None]:
        """The device is at work. Raises DeviceError if it was stopped before."""
        self.check_not_stopped()
        self.moving = True
        try:
            yield
        finally:
            self.moving = False


class OnBenchOrWire(Instrument):
    """A node whose device is simulated on the bench, simulated behind its wire, or real. ``devices`` has a
    class for each of the three. ``follows`` are the actions whose end the driver finds by a handle after a
    restart."""

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
    """A node whose driver asks its device for ``trouble``. It reports an error that the device reported twice
    in a row, so a short flicker is not reported. A lost connection is reported by the next question."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._reported = self._last_trouble = ""

    async def trouble(self) -> str:
        if not isinstance(self.device, Wired):
            return ""
        try:
            now = await self.device.trouble()
        except DeviceError:
            return self._reported
        self._reported, self._last_trouble = (now if now == self._last_trouble else ""), now
        return self._reported


def find_address(setup: Setup, key: str, example: str) -> str:
    """The address of the module's device from the workcell file. Raises DeviceError if there is none."""
    address = setup.config.get(key)
    if not isinstance(address, str) or not address:
        raise make_refusal(
            setup.name,
            f"the workcell names no {key} for this device",
            f"Write `config: {{{key}: {example}}}` for the module, or start with --simulate.",
        )
    return address


def parse_host_port(address: str, port: int) -> tuple[str, int]:
    """The host and the port in ``host``, ``host:port`` or a URL of them. Without a port, it is ``port``.
    Raises DeviceError."""
    host, colon, digits = address.rpartition("//")[2].partition(":")
    if colon and not digits.isdecimal():
        raise DeviceError(
            f"{address!r} is no address.", effects="none", remedy="Write it as host or as host:port."
        )
    return host, int(digits) if colon else port
