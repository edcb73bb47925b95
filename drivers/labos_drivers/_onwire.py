"""Simulated devices behind a wire: they receive bytes, move in lab time, and may send at any time.

Like all simulated devices, they know nothing of effects, of occupancy, or of the driver at the other end of
the wire.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from labos.link import FarEnd, ReceivingDevice, TimedDevice, serial_end
from labos.node import Crash, Setup
from labos_drivers._simulation import Simulated


class Timed(TimedDevice, Simulated):
    """A simulated device with its own thread. Its durations vary at random."""

    def __init__(self, setup: Setup) -> None:
        Simulated.__init__(self, setup)
        TimedDevice.__init__(self, setup)

    def damage(self, crash: Crash) -> None:
        """The device has collided with something: it stops and reports this."""
        raise NotImplementedError

    def read_clock(self) -> float:
        return time.monotonic() * self._pace

    def after(self, lab_s: float, what: Callable[[], None], *, exact: bool = False) -> None:
        """Do something after this number of lab seconds, which varies at random unless ``exact``."""
        super().after(lab_s if exact else self.scatter(lab_s), what)


class OnWire(Timed, ReceivingDevice):
    """A device at the far end of a line. Subclasses implement the reaction to bytes (``receive``)."""

    def __init__(self, setup: Setup, end: FarEnd | None = None) -> None:
        super().__init__(setup)
        self.end = self.far_end = end or self.make_end()

    def make_end(self) -> FarEnd:
        """The far end of the device, if ``__init__`` gets none."""
        return serial_end()


class OnLine(OnWire):
    """A device that receives lines. Subclasses implement the reaction to each line (``obey``)."""

    line_end = b"\n"
    _partial = b""

    def receive(self, data: bytes) -> None:
        *lines, self._partial = (self._partial + data).split(self.line_end)
        for line in lines:
            self.obey(line.strip().decode("utf-8", "replace"))

    def obey(self, line: str) -> None:
        """React to a received line, which is given without its line end."""
        raise NotImplementedError
