"""What the torture suite has to know of the Infinite."""

from __future__ import annotations

from labos.node import Case, Fault, Foreign, Torture, World
from labos_drivers.tecan.wire import TecanOnWire

HERE = "labos_drivers.tecan.driver"


def _lamp(reader: TecanOnWire, world: World, *, dead: bool) -> None:
    reader.lamp_dead = dead


def _no_plate(reader: TecanOnWire, world: World) -> None:
    world.carry(reader.top(reader.place("default")), "")
    reader.sensor = "FREE"


def _pushed_in(reader: TecanOnWire, world: World) -> None:
    reader.push()


TORTURE = Torture(
    device=TecanOnWire,
    cases=(
        Case(
            "measure_sample",
            {"start": 400.0, "end": 440.0, "step": 20.0},
            stock={"default": "plate96"},
            prepare=_pushed_in,
        ),
        Case("measure_sample", {"protocol_path": "ECP"}, refused="knows no stored methods"),
    ),
    faults=(
        Fault(
            "its lamp is dead",
            lambda reader, world: _lamp(reader, world, dead=True),
            lambda reader, world: _lamp(reader, world, dead=False),
        ),
        Fault("no plate on its carrier", _no_plate),
    ),
    motion="measure_sample",
    waits={f"{HERE}:GATE_S": 4.0, f"{HERE}:ROW_S": 4.0, f"{HERE}:INIT_S": 6.0, f"{HERE}:ANSWER_S": 1.5},
    foreign=(Foreign("PyLabRobot", "0.2.2", "tests/drivers/test_tecan_wire.py"),),
)
