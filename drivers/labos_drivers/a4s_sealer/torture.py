"""The declaration of the a4S sealer for the torture suite."""

from __future__ import annotations

from labos.node import Case, Fault, Foreign, Torture
from labos_drivers._torture import refill, remove_plate, use_up
from labos_drivers.a4s_sealer.wire import SealerOnWire

HERE = "labos_drivers.a4s_sealer.driver"


TORTURE = Torture(
    device=SealerOnWire,
    cases=(
        Case(
            "seal",
            {"time": 3.0, "temperature": 175.0},
            record=lambda args: {"time_s": args["time"], "temperature_c": args["temperature"]},
        ),
    ),
    faults=(
        Fault("out of foil", use_up("foil"), refill("foil", 1000)),
        Fault.by_setting("its cleaning door is open", "door_is_shut", to=False, back=True),
        Fault("an empty nest, in which it jams", remove_plate("default")),
    ),
    waits={
        f"{HERE}:RECORD_S": 4.0,
        f"{HERE}:BEGIN_S": 6.0,
        f"{HERE}:CYCLE_S": 10.0,
        f"{HERE}:SHUTTLE_S": 10.0,
    },
    foreign=(Foreign("PyLabRobot", "0.2.2", "tests/drivers/test_pylabrobot.py"),),
)
