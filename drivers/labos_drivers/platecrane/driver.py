"""The driver of a real PlateCrane over its serial port."""

from __future__ import annotations

from labos_drivers._hudson import HudsonDriver, PlateCraneDialect, Sizes
from labos_drivers.platecrane.simulator import STACKS

SIZES = Sizes(
    plate_mm=14.0,
    grip_mm=3.0,
    lid_mm=9.0,
    clear_mm=12.4,
    travel_z=2500.0,
    retracted_y=-308.0,
    near=40.0,
)

HEIGHT_OFFSETS = (
    -int(SIZES.grip_mm * PlateCraneDialect.unit),
    int(SIZES.plate_mm * PlateCraneDialect.unit),
)
"""In motor steps. Lower, the fingers would touch what the plate stands on, 3 mm above which they grip;
higher, they would close above a plate. Published workflows raise by 650 and 700 (AD-SDL/rpl_workcell)."""


class PlateCraneDriver(HudsonDriver):
    """The positions of this arm are in motor steps."""

    dialect = PlateCraneDialect()
    sizes = SIZES
    limits = {"R": (0, 330_000), "Z": (-36_000, 3_000), "P": (-2_000, 31_000), "Y": (-400, 6_000)}
    codes = {
        2: "it does not know this point",
        14: "the Z axis failed; it has to be homed",
        21: "the R axis failed; it has to be homed",
        1400: "the Z axis has hit something",
    }
    stacks = STACKS
    speed_percent = 50.0
