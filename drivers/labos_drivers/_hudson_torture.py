"""What the torture suite has to know of the arms of Hudson Robotics alike."""

from __future__ import annotations

from collections.abc import Callable

from labos.node import Fault, World
from labos_drivers._hudson_device import HudsonOnWire

HERE = "labos_drivers._hudson"
WAITS = {
    f"{HERE}:ECHO_S": 4.0,
    f"{HERE}:ANSWER_S": 4.0,
    f"{HERE}:MOTION_S": 15.0,
    f"{HERE}:HOME_S": 15.0,
}
Strike = Callable[[HudsonOnWire, World], None]


def close_fingers_on_plate(arm: HudsonOnWire, world: World) -> None:
    """Somebody puts a plate between its fingers."""
    arm.fingers = "between"


def open_fingers(arm: HudsonOnWire, world: World) -> None:
    """Somebody opens its fingers."""
    arm.fingers = "open"


def is_moving_empty(arm: HudsonOnWire, world: World) -> bool:
    return arm.is_in_motion and not is_holding(arm, world)


def is_holding(arm: HudsonOnWire, world: World) -> bool:
    return bool(world.at(f"hand:{arm.name}"))


def make_faults(source: str, target: str) -> tuple[Fault, ...]:
    """Faults of a transfer between two places of the arm's own."""

    def remove_plate(arm: HudsonOnWire, world: World) -> None:
        world.carry(arm.top(arm.place(source)), "")

    def occupy_target(arm: HudsonOnWire, world: World) -> None:
        world.stock(arm.place(target), "plate96")

    return (
        Fault("no plate at the source", remove_plate),
        Fault("a plate at the target already", occupy_target),
        Fault("it loses the plate on its way", _make_slippery(True), _make_slippery(False)),
        Fault("it does not know any more where its axes are", _lose_position),
    )


def _make_slippery(slips: bool) -> Strike:
    def set_slippery(arm: HudsonOnWire, world: World) -> None:
        arm.is_slippery = slips

    return set_slippery


def _lose_position(arm: HudsonOnWire, world: World) -> None:
    arm.homed = False
