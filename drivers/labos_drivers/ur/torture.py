"""The declaration of the UR arm for the torture suite."""

from __future__ import annotations

from labos.node import Case, Fault, Foreign, Setup, Torture, World
from labos_drivers._torture import is_holding, occupy, remove_plate
from labos_drivers.ur import protocol, rtde
from labos_drivers.ur.wire import UROnWire

HERE = "labos_drivers.ur.driver"
SAMPLE = {"plate": "bench.wells", "well": "A1", "liquid_1": "water", "liquid_2": "silica"}


def _make_cold(setup: Setup) -> UROnWire:
    """A controller that was just switched on: its joints have no power."""
    return UROnWire(setup, started=False)


def _press_stop(arm: UROnWire, world: World) -> None:
    arm.press_stop()


def _release_stop(arm: UROnWire, world: World) -> None:
    arm.safety = protocol.NORMAL


def _cause_safety_fault(arm: UROnWire, world: World) -> None:
    arm.safety, arm.mode = "FAULT", protocol.OFF


def _is_moving_empty(arm: UROnWire, world: World) -> bool:
    return arm.state == protocol.PLAYING and not is_holding(arm, world)


TORTURE = Torture(
    device=_make_cold,
    config=lambda address: {"host": address},
    cases=(
        Case("undock", {"tool": "pipette"}),
        Case("create_sample", SAMPLE),
        Case("create_sample", {**SAMPLE, "well": "B7"}, refused="it has no program for create_sample"),
        Case("transfer"),
        Case(
            "transfer",
            {"source": "bench.target", "target": "bench.source"},
            refused="it has no program that goes from",
        ),
        Case("run_urp_program", {"program_name": "wave.urp"}),
        Case("run_urp_program", {"program_name": "wave.urp\nshutdown"}, refused="is no name of a program"),
    ),
    faults=(
        Fault("no plate at the source", remove_plate("bench.source")),
        Fault("a plate at the target already", occupy("bench.target")),
        Fault.by_setting("the program is stopped on the pendant", "stopped_by_hand"),
        Fault("its emergency stop is pressed", _press_stop, _release_stop),
        Fault("a fault of its safety system", _cause_safety_fault),
        Fault.by_setting("it is not in remote control", "remote", to=False, back=True),
    ),
    settings={
        "gripper": "robotiq",
        "pendant": {
            "pipette_input": rtde.TOOL_INPUTS,
            "tip_input": rtde.TOOL_INPUTS + 1,
            "dock_input": 0,
            "pick_pipette": "pick_pipette.urp",
            "place_pipette": "place_pipette.urp",
            "dock": "dock.urp",
            "undock": [
                {"tool": "pipette", "program": "lift_pipette.urp"},
                {"tool": "", "program": "leave_pipette.urp"},
            ],
            "create_sample": [{**SAMPLE, "program": "water_silica_a1.urp"}],
            "run_droplet": "droplet.urp",
            "dispose_tip": "dispose_tip.urp",
        },
        "programs": [
            {"program": "carry.urp", "source": "bench.source", "target": "bench.target"},
            {"program": "pick.urp", "source": "bench.source", "target": "gripper"},
            {"program": "put.urp", "source": "gripper", "target": "bench.target"},
            {"program": "wave.urp"},
        ],
    },
    motion="transfer",
    moments=(_is_moving_empty, is_holding),
    waits={
        f"{HERE}:ANSWER_S": 3.0,
        f"{HERE}:PROGRAM_S": 30.0,
        f"{HERE}:POWER_S": 15.0,
        f"{HERE}:POLL_S": 0.02,
        "labos_drivers.ur.stream:ANSWER_S": 3.0,
    },
    foreign=(
        Foreign("ur-rtde (its dashboard client and its receiver)", "1.6.5", "tests/drivers/test_ur_wire.py"),
    ),
)
