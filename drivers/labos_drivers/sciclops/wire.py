"""A simulated SciClops. A serial line replaces its USB endpoints."""

from __future__ import annotations

from labos_drivers._hudson import Joints, SciclopsDialect
from labos_drivers._hudson_device import HudsonOnWire
from labos_drivers.sciclops.driver import SIZES
from labos_drivers.sciclops.simulator import TOWERS


class SciclopsOnWire(HudsonOnWire):
    """The simulated SciClops. Its towers and nests are taught points with invented coordinates."""

    dialect = SciclopsDialect()
    sizes = SIZES
    points = {
        **{tower: Joints(130.0 + 18 * n, -420.0, 10.0, 170.0) for n, tower in enumerate(TOWERS)},
        "exchange": Joints(109.0, -380.0, 100.0, 33.0),
        "lidnest1": Joints(169.0, -300.0, 10.0, 26.0),
        "lidnest2": Joints(201.0, -300.0, 10.0, 26.0),
    }
    stacks = TOWERS
    speeds = Joints(120.0, 300.0, 180.0, 250.0)
    code_of_data = "0000 "

    def format_position(self, joints: Joints) -> str:
        r, z, p, y = joints.as_tuple()
        return f"Z:{z:.4f}, R:{r:.4f}, Y:{y:.4f}, P:{p:.4f}"

    def _send_result(self, code: int) -> None:
        self.send(f"{code:04d} {'Success' if not code else 'Error'}\r\n".encode())
