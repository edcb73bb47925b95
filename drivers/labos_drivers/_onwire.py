"""Simulated devices behind a wire: they receive bytes, move in lab time, and send when they like.

As with every simulated device, nothing here knows of effects or occupancy, nor of the driver at the
other end.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from labos.link import FarEnd, ReceivingDevice, TimedDevice, serial_end
from labos.node import Crash, Setup
from labos_drivers._simulation import Simulated


class Timed(TimedDevice, Simulated):
    """A simulated device with a thread of its own, whose durations scatter."""

    def __init__(self, setup: Setup) -> None:
        Simulated.__init__(self, setup)
        TimedDevice.__init__(self, setup)

    def damage(self, crash: Crash) -> None:
        """Something was hit: the device stands still and reports it."""
        raise NotImplementedError

    def read_clock(self) -> float:
        return time.monotonic() * self._pace

    def after(self, lab_s: float, what: Callable[[], None], *, exact: bool = False) -> None:
        """Do something in so many lab seconds; the time scatters unless ``exact``."""
        super().after(lab_s if exact else self.scatter(lab_s), what)


class OnWire(Timed, ReceivingDevice):
    """A device at the far end of a line; subclasses say what it does with what it receives (``receive``)."""

    def __init__(self, setup: Setup, end: FarEnd | None = None) -> None:
        super().__init__(setup)
        self.end = self.far_end = end or self.make_end()

    def make_end(self) -> FarEnd:
        """The far end that the device has if none is given."""
        return serial_end()


class OnLine(OnWire):
    """A device that receives lines; subclasses say what it does with each (``obey``)."""

    line_end = b"\n"
    _partial = b""

    def receive(self, data: bytes) -> None:
        *lines, self._partial = (self._partial + data).split(self.line_end)
        for line in lines:
            self.obey(line.strip().decode("utf-8", "replace"))

    def obey(self, line: str) -> None:
        """A line was received; it is given without its end."""
        raise NotImplementedError
