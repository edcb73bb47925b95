"""The Infinite under torture in the midst of its measurements, and not of its carrier's way."""

from __future__ import annotations

import msgspec

from labos.node import Case, Fault, World
from labos_drivers.tecan.interface import Tecan
from labos_drivers.tecan.torture import TORTURE as OF_THE_CARRIER
from labos_drivers.tecan.wire import TecanOnWire


class Measuring(Tecan):
    """A reader that measures."""


def _lamp(reader: TecanOnWire, world: World, *, dead: bool) -> None:
    reader.lamp_dead = dead


def _no_plate(reader: TecanOnWire, world: World) -> None:
    world.carry(reader.top(reader.place("default")), "")
    reader.sensor = "FREE"


def _push_in(reader: TecanOnWire, world: World) -> None:
    reader.push()


TORTURE = msgspec.structs.replace(
    OF_THE_CARRIER,
    device=TecanOnWire,
    cases=(
        Case(
            "measure_sample",
            {"start": 400.0, "end": 440.0, "step": 20.0},
            stock={"default": "plate96"},
            prepare=_push_in,
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
)
