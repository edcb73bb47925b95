"""The declaration of the STX incubator for the torture suite."""

from __future__ import annotations

from labos.node import Case, Fault, Foreign, Torture
from labos_drivers._torture import occupy, remove_plate
from labos_drivers.liconic.wire import LiconicOnWire

HERE = "labos_drivers.liconic.driver"


TORTURE = Torture(
    device=LiconicOnWire,
    cases=(
        Case("load_plate", {"stacker": 1, "slot": 2}),
        Case("unload_plate", {"stacker": 3, "slot": 22}),
        Case("store", refused="does not choose slots"),
        Case("retrieve", {"slot": "stacker1_slot7"}, stock={"stacker1_slot7": "plate96"}),
        Case("set_target_temp", {"temperature": 37.0}),
        Case("set_target_humidity", {"humidity": 80.0}),
    ),
    faults=(
        Fault("no plate on the transfer station", remove_plate("exchange")),
        Fault("a plate in the slot already", occupy("stacker1_slot2")),
    ),
    settings={"parity": "N"},  # a pseudo-terminal accepts even parity only when it is first opened
    motion="load_plate",
    waits={f"{HERE}:START_S": 10.0, f"{HERE}:MOVE_S": 10.0},
    foreign=(Foreign("PyLabRobot", "0.2.2", "tests/drivers/test_pylabrobot.py"),),
)
