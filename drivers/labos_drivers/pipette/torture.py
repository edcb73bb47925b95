"""The declaration of the pipette for the torture suite."""

from __future__ import annotations

from typing import Any

from labos.node import Case, Fault, Torture, World
from labos_drivers.pipette.wire import PipetteOnWire

HERE = "labos_drivers.pipette.driver"


def _empty_barrel(pipette: PipetteOnWire, world: World) -> None:
    pipette.put(0)


def _fill_barrel(pipette: PipetteOnWire, world: World) -> None:
    pipette.put(pipette.kind.steps)


def _make_record(args: dict[str, Any]) -> dict[str, Any]:
    return {"ul": args["volume"]}


TORTURE = Torture(
    device=PipetteOnWire,
    settings={"kind": "air_z"},
    cases=(
        Case("aspirate", {"volume": 100.0, "speed": 10.0}, prepare=_empty_barrel, record=_make_record),
        Case("dispense", {"volume": 100.0, "speed": 50.0}, prepare=_fill_barrel, record=_make_record),
    ),
    faults=(Fault.by_setting("its plunger sticks", "stuck"), Fault("it is full", _fill_barrel)),
    motion="aspirate",
    waits={f"{HERE}:ANSWER_S": 1.0, f"{HERE}:LOST_S": 3.0, f"{HERE}:POLL_S": 0.05, f"{HERE}:START_S": 20.0},
)
