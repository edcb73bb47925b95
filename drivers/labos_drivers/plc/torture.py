"""What the torture suite needs to know about the PLC of the hatch."""

from __future__ import annotations

from labos.node import Case, Fault, Torture, World
from labos_drivers.plc.wire import Hatch, HatchOnTcp

HERE = "labos_drivers.plc.driver"


def _push_door(open_: bool, hatch: Hatch, world: World) -> None:
    """A person moves the door by hand: the motor does not hold it while it stands still."""
    hatch.position = 1.0 if open_ else 0.0
    if world.is_shut(hatch.nest) == open_:
        world.gate("person", hatch.nest, shut=not open_)


def open_door(hatch: Hatch, world: World) -> None:
    _push_door(True, hatch, world)


def close_door(hatch: Hatch, world: World) -> None:
    _push_door(False, hatch, world)


TORTURE = Torture(
    device=HatchOnTcp,
    config=lambda address: {"address": address},
    cases=(
        Case("open", {"speed": 50.0}, prepare=close_door),
        Case("close", {"speed": 50.0}, prepare=open_door),
    ),
    faults=(
        Fault.by_setting("the door is jammed", "jammed"),
        Fault.by_setting("somebody reaches into the light curtain", "curtain"),
        Fault.by_setting("the emergency stop is pressed", "emergency"),
    ),
    motion="close",
    waits={f"{HERE}:PATIENCE_S": 4.0},
)
