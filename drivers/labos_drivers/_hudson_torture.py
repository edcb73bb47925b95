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


def closed_on_a_plate(arm: HudsonOnWire, world: World) -> None:
    """Somebody puts one between its fingers."""
    arm.fingers = "between"


def opened(arm: HudsonOnWire, world: World) -> None:
    """Somebody opens its fingers."""
    arm.fingers = "open"


def on_its_way(arm: HudsonOnWire, world: World) -> bool:
    return arm.is_in_motion and not holds(arm, world)


def holds(arm: HudsonOnWire, world: World) -> bool:
    return bool(world.at(f"hand:{arm.name}"))


def faults(source: str, target: str) -> tuple[Fault, ...]:
    """Of a transfer from a place of the arm's own to another."""

    def no_plate(arm: HudsonOnWire, world: World) -> None:
        world.carry(arm.top(arm.place(source)), "")

    def taken_target(arm: HudsonOnWire, world: World) -> None:
        world.stock(arm.place(target), "plate96")

    return (
        Fault("no plate at the source", no_plate),
        Fault("a plate at the target already", taken_target),
        Fault("it loses the plate on its way", _slips(True), _slips(False)),
        Fault("it does not know any more where its axes are", _lost),
    )


def _slips(slips: bool) -> Strike:
    def set_it(arm: HudsonOnWire, world: World) -> None:
        arm.is_slippery = slips

    return set_it


def _lost(arm: HudsonOnWire, world: World) -> None:
    arm.homed = False
