"""What the torture suite has to know of the SciClops."""

from __future__ import annotations

from labos.node import Case, Setup, Torture
from labos_drivers._hudson_torture import WAITS, closed_on_a_plate, faults, holds, on_its_way, opened
from labos_drivers.sciclops.wire import SciclopsOnWire


def _cold(setup: Setup) -> SciclopsOnWire:
    """Not homed, as it is after its switch was turned."""
    return SciclopsOnWire(setup, homed=False)


TORTURE = Torture(
    device=_cold,
    cases=(
        Case("get_plate", {"loc": "tower1"}),
        Case(
            "get_plate",
            {"loc": "tower2"},
            stock={"tower1": "plate96"},
            refused="the gripper touched the floor",
        ),
        Case("transfer", {"source": "exchange", "target": "tower2"}),
        Case("transfer", {"source": "exchange", "target": "bench.unknown"}, refused="was not taught"),
        Case("put_down", prepare=closed_on_a_plate),
        Case("put_down", stock={"tower1": "plate96"}, refused="its hand is empty"),
    ),
    faults=faults("tower1", "exchange"),
    settings={"speed_percent": 100},
    motion="get_plate",
    moments=(on_its_way, holds),
    clear=opened,
    waits=WAITS,
)
