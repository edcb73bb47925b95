"""What the torture suite needs to know about the SciClops."""

from __future__ import annotations

from labos.node import Case, Setup, Torture
from labos_drivers._hudson_torture import (
    WAITS,
    close_fingers_on_plate,
    make_faults,
    open_fingers,
)
from labos_drivers._torture import is_holding, is_moving_empty
from labos_drivers.sciclops.wire import SciclopsOnWire


def _make_cold(setup: Setup) -> SciclopsOnWire:
    """A simulated SciClops that is not homed, as after it is switched on."""
    return SciclopsOnWire(setup, homed=False)


TORTURE = Torture(
    device=_make_cold,
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
        Case("put_down", prepare=close_fingers_on_plate),
        Case("put_down", stock={"tower1": "plate96"}, refused="its hand is empty"),
    ),
    faults=make_faults("tower1", "exchange"),
    settings={"speed_percent": 100},
    motion="get_plate",
    moments=(is_moving_empty, is_holding),
    clear=open_fingers,
    waits=WAITS,
)
