"""The declaration of the XPeel for the torture suite."""

from __future__ import annotations

from labos.node import Case, Fault, Foreign, Setup, Torture
from labos_drivers._torture import refill, remove_plate, use_up
from labos_drivers.brooks_peeler.wire import PeelerOnWire

HERE = "labos_drivers.brooks_peeler.driver"


def _make_peeler(setup: Setup) -> PeelerOnWire:
    """A peeler with a short seal check, so that an interruption falls into the peel itself."""
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
        Fault("no plate in the nest", remove_plate("default")),
        Fault.by_setting("the cover is open", "cover_is_shut", to=False, back=True),
        Fault("out of tape", use_up("tape"), refill("tape", 600)),
    ),
    # The device sends these after its power returns, or when a person uses its front panel.
    unasked=(b"*poweron\r\n", b"*homing\r\n", b"*ready:00,00,00\r\n"),
    waits={f"{HERE}:ACK_S": 3.0, f"{HERE}:MOTION_S": 6.0, f"{HERE}:HOMING_S": 6.0},
    foreign=(Foreign("PyLabRobot", "0.2.2, but for its peel", "tests/drivers/test_pylabrobot.py"),),
)
