"""A simulated PlateCrane at the far end of a serial line."""

from __future__ import annotations

from labos_drivers._hudson import Joints, PlateCraneDialect
from labos_drivers._hudson_device import HudsonOnWire
from labos_drivers.platecrane.driver import SIZES
from labos_drivers.platecrane.simulator import STACKS


class PlateCraneOnWire(HudsonOnWire):
    """Has taught poses for its own stacks and nests; their numbers are invented."""

    dialect = PlateCraneDialect()
    sizes = SIZES
    points = {
        **{stack: Joints(20_000.0 * (n + 1), -32_700.0, 460.0, 5_420.0) for n, stack in enumerate(STACKS)},
        **{f"LidNest{n}": Joints(150_000.0 + 10_000 * n, -31_000.0, 460.0, 4_132.0) for n in range(1, 4)},
    }
    stacks = STACKS
    speeds = Joints(60_000.0, 15_000.0, 15_000.0, 5_000.0)

    def format_position(self, joints: Joints) -> str:
        return ", ".join(f"{value:.0f}" for value in joints.as_tuple())
