"""The declaration of the incubator for the torture suite."""

from __future__ import annotations

from labos.node import Case, Fault, Foreign, Torture, World
from labos_drivers.inheco.wire import InhecoOnWire

HERE = "labos_drivers.inheco.driver"


def _pull_drawer_out(incubator: InhecoOnWire, world: World) -> None:
    incubator.pull(open_=True)


def _push_drawer_in(incubator: InhecoOnWire, world: World) -> None:
    incubator.pull(open_=False)


TORTURE = Torture(
    device=InhecoOnWire,
    cases=(
        Case("open_door", prepare=_push_drawer_in),
        Case("close_door", prepare=_pull_drawer_out),
        Case("set_temperature", {"temperature": 37.0}),
        Case(
            "begin_shake",
            {"speed": 600.0, "amplitude": 2.0},
            record=lambda args: {"rpm": args["speed"], "mm": args["amplitude"]},
        ),
    ),
    faults=(Fault.by_setting("its drawer jams", "jammed"),),
    foreign=(Foreign("PyLabRobot", "0.2.2", "tests/drivers/test_inheco_wire.py"),),
    motion="close_door",
    waits={f"{HERE}:DRAWER_S": 4.0, f"{HERE}:SHAKER_S": 4.0, f"{HERE}:POLL_S": 0.05, f"{HERE}:ANSWER_S": 1.5},
)
