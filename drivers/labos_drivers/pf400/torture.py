"""The declaration of the PF400 for the torture suite."""

from __future__ import annotations

from labos.node import Case, Fault, Foreign, Setup, Torture, World
from labos_drivers._torture import is_holding, is_moving_empty, occupy, remove_plate
from labos_drivers.pf400.protocol import NARROW
from labos_drivers.pf400.wire import PF400OnWire

HERE = "labos_drivers.pf400.driver"
TURNS = {"source_plate_rotation": "narrow", "target_plate_rotation": "wide"}
WAY = {"source": "bench.source", "target": "bench.target"}


def _make_cold(setup: Setup) -> PF400OnWire:
    """A simulated arm as after a power loss: without power, not attached, not homed."""
    return PF400OnWire(setup, started=False)


def _close_fingers_on_plate(arm: PF400OnWire, world: World) -> None:
    arm.set_fingers(NARROW.closed_mm)


def _open_fingers(arm: PF400OnWire, world: World) -> None:
    arm.set_fingers(NARROW.open_mm)


def _press_stop(arm: PF400OnWire, world: World) -> None:
    arm.press_stop()


def _release_stop(arm: PF400OnWire, world: World) -> None:
    arm.stop_is_pressed = False


TORTURE = Torture(
    device=_make_cold,
    config=lambda address: {"host": address},
    cases=(
        Case("transfer", WAY),
        Case("transfer", {**WAY, **TURNS}),
        Case("transfer", {**WAY, "target": "bench.unknown"}, refused="was not taught"),
        Case("put_down", {"target": "bench.target"}, prepare=_close_fingers_on_plate),
        Case("put_down", {"target": "bench.target"}, stock={"bench.source": "plate96"}, refused="is empty"),
    ),
    faults=(
        Fault("no plate at the source", remove_plate("bench.source")),
        Fault("a plate at the target already", occupy("bench.target")),
        Fault.by_setting("it loses the plate on its way", "is_slippery"),
        Fault("its emergency stop is pressed", _press_stop, _release_stop),
    ),
    poses={
        "bench.source": [205.128, -2.814, 264.373, 365.863, 79.144, 411.553],
        "bench.target": [163.230, -59.032, 270.965, 415.013, 79.144, -451.510],
        "bench.regrip": [188.2, -12.506, 251.918, 388.242, 80.116, 151.300],
    },
    regrip="bench.regrip",
    moments=(is_moving_empty, is_holding),
    clear=_open_fingers,
    waits={f"{HERE}:ANSWER_S": 3.0, f"{HERE}:MOVE_S": 15.0, f"{HERE}:HOME_S": 15.0, f"{HERE}:POWER_S": 10.0},
    foreign=(Foreign("PyLabRobot", "0.2.2", "tests/drivers/test_pylabrobot.py"),),
)
