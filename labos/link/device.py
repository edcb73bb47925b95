"""Simulated devices at the far end of a line, for tests and for trying a driver without its instrument. A
device receives bytes, works in lab time and sends bytes at any time. It has its own state in ``setup.world``
and does not know the driver at the other end. Real devices do not need this module.
"""

from __future__ import annotations

import heapq
import itertools
import threading
import time
from collections.abc import Callable

import structlog

from labos.link.farend import FarEnd, serial_end
from labos.node.node import Setup
from labos.node.world import Crash, World

LONGEST_WAIT_S = 0.05

_log = structlog.get_logger(__name__)


class TimedDevice:
    """A device with its own thread, so that it does one thing at a time. Subclasses implement the wait for
    input (``listen``), and plan later work with ``after``.
    """

    name: str

    def __init__(self, setup: Setup) -> None:
        self._pace = setup.pace
        self._began = time.monotonic()
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._live, name=f"{setup.name} device", daemon=True)

    def start(self) -> None:
        """Power on."""
        self._thread.start()

    def close(self) -> None:
        """Power off."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join(5)

    def do_at_once(self, what: Callable[[], None]) -> None:
        """Let the device do something, called from another thread, and wait until it is done. Raises
        TimeoutError after 5 s: the device was not started or has been closed.
        """
        is_done = threading.Event()

        def do() -> None:
            what()
            is_done.set()

        TimedDevice.after(self, 0, do)
        if not is_done.wait(5):
            raise TimeoutError(f"{self.name}: the simulated device has failed.")

    # -- for subclasses ----------------------------------------------------------------------

    @property
    def address(self) -> str:
        """The address that a driver opens."""
        raise NotImplementedError

    def power_on(self) -> None:
        """The device has just been switched on."""

    def listen(self, timeout_s: float) -> None:
        """Wait for input for this time, and react to it."""
        raise NotImplementedError

    def damage(self, crash: Crash) -> None:
        """The device has collided with something on the bench: it stops, and should report this."""
        _log.warning("simulated_device_crashed", device=self.name, what=str(crash))

    def now_s(self) -> float:
        """Lab time since the device was made."""
        return (time.monotonic() - self._began) * self._pace

    def after(self, lab_s: float, what: Callable[[], None]) -> None:
        """Do something after this number of lab seconds."""
        heapq.heappush(self._due, (time.monotonic() + lab_s / self._pace, next(self._count), what))

    def forget_plans(self) -> None:
        """Cancel everything that was planned with `after`."""
        self._due.clear()

    # -- inside ------------------------------------------------------------------------------

    def _live(self) -> None:
        self.power_on()
        while not self._over.is_set():
            wait = self._due[0][0] - time.monotonic() if self._due else LONGEST_WAIT_S
            try:
                self.listen(min(max(wait, 0.0), LONGEST_WAIT_S))
                while self._due and self._due[0][0] <= time.monotonic():
                    heapq.heappop(self._due)[2]()
            except Crash as crash:
                self.damage(crash)
            except Exception:
                if not self._over.is_set():
                    _log.exception("simulated_device_failed", device=self.name)


class ReceivingDevice(TimedDevice):
    """A device at the far end of a line (``far_end``, which subclasses set). Subclasses implement the
    reaction to received bytes (``receive``)."""

    far_end: FarEnd

    @property
    def address(self) -> str:
        """The port that a driver opens."""
        return self.far_end.address

    def close(self) -> None:
        super().close()
        self.far_end.close()

    def listen(self, timeout_s: float) -> None:
        if data := self.far_end.read(timeout_s):
            self.receive(data)

    def receive(self, data: bytes) -> None:
        """Bytes were received."""
        raise NotImplementedError

    def send(self, data: bytes) -> None:
        self.far_end.write(data)


class DeviceOnLine(ReceivingDevice):
    """A device on a line with a bench around it. Subclasses implement the reaction to each received line
    (``obey``) or to received bytes (``receive``), and plan later work with ``after``. ``line_end`` is the end
    of received and sent lines.
    """

    line_end = b"\r\n"

    def __init__(self, setup: Setup, end: FarEnd | None = None) -> None:
        if setup.world is None:
            raise ValueError(f"{setup.name}: a simulated device needs a world that stores its state")
        super().__init__(setup)
        self.name = setup.name
        self.world: World = setup.world
        self.far_end = end or serial_end()
        self._place = setup.place
        self._line = b""

    def obey(self, line: str) -> None:
        """A line was received; it is given without its end."""
        raise NotImplementedError

    def receive(self, data: bytes) -> None:
        *lines, self._line = (self._line + data).split(self.line_end)
        for line in lines:
            self.obey(line.decode("ascii", "replace"))

    def place(self, station: str) -> str:
        """The name in the world of a station of this device."""
        return self._place(station)

    def send_line(self, line: str) -> None:
        """Send a line."""
        self.send(line.encode("ascii") + self.line_end)
