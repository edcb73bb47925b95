"""What the declarations of all arms of Hudson Robotics for the torture suite share."""

from __future__ import annotations

from labos.node import Fault, World
from labos_drivers._hudson_device import HudsonOnWire
from labos_drivers._torture import occupy, remove_plate

HERE = "labos_drivers._hudson"
WAITS = {
    f"{HERE}:ECHO_S": 4.0,
    f"{HERE}:ANSWER_S": 4.0,
    f"{HERE}:MOTION_S": 15.0,
    f"{HERE}:HOME_S": 15.0,
}


def close_fingers_on_plate(arm: HudsonOnWire, world: World) -> None:
    """A person puts a plate between its fingers: they are neither open nor fully closed."""
    arm.fingers = "between"


def open_fingers(arm: HudsonOnWire, world: World) -> None:
    """A person opens its fingers."""
    arm.fingers = "open"


def make_faults(source: str, target: str) -> tuple[Fault, ...]:
    """The faults of a transfer between two of the arm's own places."""
    return (
        Fault("no plate at the source", remove_plate(source)),
        Fault("a plate at the target already", occupy(target)),
        Fault.by_setting("it loses the plate on its way", "is_slippery"),
        Fault("it does not know any more where its axes are", _lose_position),
    )


def _lose_position(arm: HudsonOnWire, world: World) -> None:
    arm.homed = False
