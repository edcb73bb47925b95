"""Simulated devices behind a wire: they hear bytes, move in lab time, and speak when they like.

As with every simulated device, nothing here knows of effects or occupancy, nor of the driver at the
other end.
"""

from __future__ import annotations

import heapq
import itertools
import threading
import time
from collections.abc import Callable

import structlog

from labos.link import FarEnd, serial_end
from labos.node import Crash, Setup
from labos_drivers._simulation import Simulated

LONGEST_WAIT_S = 0.05

_log = structlog.get_logger(__name__)


class Timed(Simulated):
    """A device with a thread of its own: nothing in it happens twice at once.

    Subclasses say how they wait for what comes (``listen``), and what they do when (``after``).
    """

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._pace = setup.pace
        self._began = time.monotonic()
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._live, name=f"{setup.name} device", daemon=True)

    @property
    def address(self) -> str:
        """What a driver opens."""
        raise NotImplementedError

    def start(self) -> None:
        """Power on."""
        self._thread.start()

    def close(self) -> None:
        """Power off."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join(5)

    # -- for subclasses ----------------------------------------------------------------------

    def power_on(self) -> None:
        """The device has just been switched on."""

    def listen(self, timeout_s: float) -> None:
        """Wait so long for something to come, and do what it asks."""
        raise NotImplementedError

    def damage(self, crash: Crash) -> None:
        """Something was hit: the device stands still and reports it."""
        raise NotImplementedError

    def now_s(self) -> float:
        """Lab time since the device was made."""
        return (time.monotonic() - self._began) * self._pace

    def after(self, lab_s: float, what: Callable[[], None], *, exact: bool = False) -> None:
        """Do something in so many lab seconds, which scatter unless ``exact``."""
        if not exact:
            lab_s = self.scattered(lab_s)
        heapq.heappush(self._due, (time.monotonic() + lab_s / self._pace, next(self._count), what))

    def forget_plans(self) -> None:
        """Nothing that was to be done will be done."""
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


class OnWire(Timed):
    """A device at the far end of a line, which says what it does with what it hears (``hear``)."""

    def __init__(self, setup: Setup, end: FarEnd | None = None) -> None:
        super().__init__(setup)
        self.end = end or self.own_end()

    @property
    def address(self) -> str:
        return self.end.address

    def close(self) -> None:
        super().close()
        self.end.close()

    def own_end(self) -> FarEnd:
        """The end that it has if nobody gives it one."""
        return serial_end()

    def listen(self, timeout_s: float) -> None:
        if data := self.end.read(timeout_s):
            self.hear(data)

    def hear(self, data: bytes) -> None:
        """Bytes have come."""
        raise NotImplementedError

    def say(self, data: bytes) -> None:
        self.end.write(data)
