"""The declaration of the Infinite for the torture suite."""

from __future__ import annotations

from labos.node import Case, Fault, Foreign, Setup, Torture, World
from labos_drivers.tecan.wire import TecanOnWire

HERE = "labos_drivers.tecan.driver"
SLOW_S = 250.0
"""Under torture time passes so that a measurement takes a second. The carrier is slow, to be interrupted."""


def _make_reader(setup: Setup) -> TecanOnWire:
    return TecanOnWire(setup, gate_s=SLOW_S)


def _jam(reader: TecanOnWire, world: World) -> None:
    reader.jammed = True


def _free(reader: TecanOnWire, world: World) -> None:
    reader.free()


def _push_in(reader: TecanOnWire, world: World) -> None:
    reader.push()


def _pull_out(reader: TecanOnWire, world: World) -> None:
    reader.pull()


TORTURE = Torture(
    device=_make_reader,
    cases=(
        Case("open_gate", prepare=_push_in),
        Case("close_gate", prepare=_pull_out),
        Case(
            "measure_sample",
            {"start": 400.0, "end": 440.0, "step": 20.0},
            stock={"default": "plate96"},
            prepare=_push_in,
        ),
        Case("measure_sample", {"protocol_path": "ECP"}, refused="knows no stored methods"),
    ),
    faults=(
        Fault("its carrier jams", _jam, _free),
        Fault.by_setting("it refuses whatever it is told", "refuses"),
    ),
    motion="close_gate",  # measurements are interrupted in tests/drivers/tecan_measuring.py
    waits={f"{HERE}:GATE_S": 8.0, f"{HERE}:ROW_S": 4.0, f"{HERE}:INIT_S": 8.0, f"{HERE}:ANSWER_S": 1.5},
    foreign=(Foreign("PyLabRobot", "0.2.2", "tests/drivers/test_tecan_wire.py"),),
)
