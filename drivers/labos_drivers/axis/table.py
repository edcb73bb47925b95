"""The table of an axis in the workcell file: gear, ends, speeds, homing. Checks of its numbers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from labos.node.mapping import Flaw, Part, Seconds

KEY = "axis"


class Homing(Part):
    """How the axis homes. ``method`` is the number in the profile (0x6098): 17 the lower limit switch, 18 the
    upper one, 33 and 34 the index pulse, 35 and 37 the present position. The drive's manual describes others.
    ``position`` is that of the home, in the axis' unit; the speeds are in this unit per second. In the
    profile, the home offset (0x607C) is the distance from the home to zero. Some drives use it as the
    position of the home (``offset_is_position``)."""

    method: int = Field(default=17, ge=-128, le=127)
    position: float = 0.0
    offset_is_position: bool = False
    switch_speed: float = Field(default=10.0, gt=0)
    zero_speed: float = Field(default=2.0, gt=0)
    timeout: Seconds = Field(default=120.0, gt=0)


class AxisTable(Part):
    """The whole table. ``counts_per_turn`` are the counts of the encoder for one turn (with its four edges).
    ``gear`` is the number of motor turns for one turn of the output, ``travel_per_turn`` the travel of the
    axis for the same turn, in ``unit``. Speeds and accelerations are in ``unit`` per second (squared). The
    drive gets them multiplied by ``speed_scale`` and ``acceleration_scale`` (if left out: the counts in a
    unit).

    ``homed_bit`` is the bit of the statusword by which this drive reports that its position is known; None if
    it has no such bit. ``absolute``: the position is always known. ``window`` is the distance from the target
    within which the axis has arrived."""

    description: str = "An axis."
    unit: Literal["mm", "deg"] = "mm"
    counts_per_turn: int = Field(gt=0)
    gear: float = Field(default=1.0, gt=0)
    travel_per_turn: float = Field(gt=0)
    reversed: bool = False
    minimum: float
    maximum: float
    speed: float = Field(gt=0)
    highest_speed: float | None = Field(default=None, gt=0)
    acceleration: float = Field(gt=0)
    speed_scale: float | None = Field(default=None, gt=0)
    acceleration_scale: float | None = Field(default=None, gt=0)
    window: float = Field(default=0.05, gt=0)
    home: Homing = Homing()
    homed_bit: Literal[8, 14, 15] | None = None
    absolute: bool = False

    @property
    def counts_per_unit(self) -> float:
        sign = -1 if self.reversed else 1
        return sign * self.counts_per_turn * self.gear / self.travel_per_turn

    @property
    def top_speed(self) -> float:
        return self.highest_speed or self.speed

    def counts(self, position: float) -> int:
        return round(position * self.counts_per_unit)

    def position(self, counts: float) -> float:
        """The position at these counts, rounded to a thousandth of the unit."""
        return round(counts / self.counts_per_unit, 3) + 0.0

    def raw_speed(self, speed: float) -> int:
        return max(round(speed * (self.speed_scale or abs(self.counts_per_unit))), 1)

    def raw_acceleration(self) -> int:
        return max(round(self.acceleration * (self.acceleration_scale or abs(self.counts_per_unit))), 1)


STAGE = AxisTable(
    description="Linear stage of 500 mm on a spindle.",
    counts_per_turn=4096,
    gear=3.5,
    travel_per_turn=10.0,
    minimum=0.0,
    maximum=500.0,
    speed=25.0,
    highest_speed=200.0,
    acceleration=500.0,
    homed_bit=15,
)
"""The simulated one."""


def find_flaws(table: AxisTable) -> Iterator[Flaw]:
    """Numbers in a table that contradict each other, and positions with more counts than 32 bits hold."""
    if table.minimum >= table.maximum:
        yield Flaw(("maximum",), "The axis ends before it begins.", "Write a `maximum` above `minimum`.")
    elif not table.minimum <= table.home.position <= table.maximum:
        at = ("home", "position")
        yield Flaw(at, "It would home outside of its range.", "Write one between `minimum` and `maximum`.")
    for end in ("minimum", "maximum"):
        if not -(2**31) <= table.counts(getattr(table, end)) < 2**31:
            remedy = "Compare `counts_per_turn`, `gear` and `travel_per_turn` with the drive."
            yield Flaw(
                (end,),
                f"{getattr(table, end):g} {table.unit} are more counts than fit.",
                remedy,
            )
    if table.top_speed < table.speed:
        yield Flaw(("speed",), "It is faster than `highest_speed`.", "Lower it, or raise `highest_speed`.")
