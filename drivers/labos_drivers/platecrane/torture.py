"""What the torture suite has to know of the PlateCrane."""

from __future__ import annotations

from labos.node import Case, Setup, Torture
from labos_drivers._hudson_torture import WAITS, closed_on_a_plate, faults, holds, on_its_way, opened
from labos_drivers.platecrane.wire import PlateCraneOnWire


def _cold(setup: Setup) -> PlateCraneOnWire:
    """Not homed, as it is after its switch was turned."""
    return PlateCraneOnWire(setup, homed=False)


TORTURE = Torture(
    device=_cold,
    cases=(
        Case("transfer", {"source": "Stack1", "target": "bench.nest"}),
        Case("transfer", {"source": "bench.nest", "target": "Stack2"}),
        Case(
            "transfer",
            {"source": "Stack2", "target": "bench.nest"},
            stock={"Stack1": "plate96"},
            refused="the gripper touched the floor",
        ),
        Case("transfer", {"source": "Stack1", "target": "bench.unknown"}, refused="was not taught"),
        Case("put_down", {"target": "LidNest1"}, prepare=closed_on_a_plate),
        Case("put_down", {"target": "LidNest1"}, stock={"Stack1": "plate96"}, refused="its hand is empty"),
        Case("remove_lid", {"source": "bench.nest", "target": "LidNest1"}),
        Case("replace_lid", {"source": "LidNest1", "target": "bench.nest"}),
    ),
    faults=faults("Stack1", "bench.nest"),
    settings={"speed_percent": 100},
    poses={"bench.nest": [182_000.0, -30_000.0, 460.0, 4_000.0]},
    motion="transfer",
    moments=(on_its_way, holds),
    clear=opened,
    waits=WAITS,
)
