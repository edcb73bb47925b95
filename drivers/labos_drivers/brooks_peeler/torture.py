"""What the torture suite has to know of the XPeel."""

from __future__ import annotations

from labos.node import Case, Fault, Foreign, Setup, Torture, World
from labos_drivers.brooks_peeler.wire import PeelerOnWire

HERE = "labos_drivers.brooks_peeler.driver"


def _remove_plate(peeler: PeelerOnWire, world: World) -> None:
    world.carry(peeler.top(peeler.place("default")), "")


def _use_up_tape(peeler: PeelerOnWire, world: World) -> None:
    world.supply(peeler.name, "tape", -(world.find_level(peeler.name, "tape") or 0.0))


def _insert_tape(peeler: PeelerOnWire, world: World) -> None:
    world.supply(peeler.name, "tape", 600)


def _make_peeler(setup: Setup) -> PeelerOnWire:
    """It looks for the seal so quickly that what is interrupted is the peel."""
    return PeelerOnWire(setup, check_s=1.0)


TORTURE = Torture(
    device=_make_peeler,
    cases=(
        Case(
            "peel",
            {"parameter_set": 4, "adhere": 2.5},
            record=lambda args: {"set": args["parameter_set"], "adhere_s": args["adhere"]},
        ),
        Case("sealcheck", stock={"default": "plate96"}),
    ),
    faults=(
        Fault("no plate in the nest", _remove_plate),
        Fault.by_setting("the cover is open", "cover_is_shut", to=False, back=True),
        Fault("out of tape", _use_up_tape, _insert_tape),
    ),
    # As after power came back, or when somebody uses its front panel.
    unasked=(b"*poweron\r\n", b"*homing\r\n", b"*ready:00,00,00\r\n"),
    waits={f"{HERE}:ACK_S": 3.0, f"{HERE}:MOTION_S": 6.0, f"{HERE}:HOMING_S": 6.0},
    foreign=(Foreign("PyLabRobot", "0.2.2, but for its peel", "tests/drivers/test_pylabrobot.py"),),
)
