"""The declaration of the PlateCrane for the torture suite."""

from __future__ import annotations

from labos.node import Case, Setup, Torture
from labos_drivers._hudson_torture import (
    WAITS,
    close_fingers_on_plate,
    make_faults,
    open_fingers,
)
from labos_drivers._torture import is_holding, is_moving_empty
from labos_drivers.platecrane.wire import PlateCraneOnWire


def _make_cold(setup: Setup) -> PlateCraneOnWire:
    """A crane that is not homed, as after it was switched on."""
    return PlateCraneOnWire(setup, homed=False)


TORTURE = Torture(
    device=_make_cold,
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
        Case("put_down", {"target": "LidNest1"}, prepare=close_fingers_on_plate),
        Case("put_down", {"target": "LidNest1"}, stock={"Stack1": "plate96"}, refused="its hand is empty"),
        Case("remove_lid", {"source": "bench.nest", "target": "LidNest1"}),
        Case("replace_lid", {"source": "LidNest1", "target": "bench.nest"}),
    ),
    faults=make_faults("Stack1", "bench.nest"),
    settings={"speed_percent": 100},
    poses={"bench.nest": [182_000.0, -30_000.0, 460.0, 4_000.0]},
    motion="transfer",
    moments=(is_moving_empty, is_holding),
    clear=open_fingers,
    waits=WAITS,
)
