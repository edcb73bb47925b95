"""An incubator that chooses the slot itself, says which, and gives any plate back."""

from __future__ import annotations

import pytest

from labos.core.decide.runs import SubmitRun
from tests.simulation.corners import Corner

CORNER = Corner("""
labos: 1
name: corner
modules:
  - {name: left, model: sciclops}
  - {name: ur, model: ur5}
  - {name: incubator, model: liconic}
  - {name: reader, model: hidex}
stations:
  wc.trash: {kind: waste}
stock:
  left.tower1: {plate96: 20}
""")


def stored(name: str, rounds: int, *end: str) -> SubmitRun:
    return CORNER.run(
        name,
        "left.get_plate loc=tower1",
        "ur.transfer source=left.exchange target=incubator.exchange",
        "incubator.store",
        *["reader.close_lid", "reader.open_lid"] * rounds,
        *end,
    )


OUT = ("incubator.retrieve", "ur.transfer source=incubator.exchange target=wc.trash")
RUNS = [stored("long", 4, *OUT), stored("short", 1, *OUT), stored("stays", 1)] * 2


def test_every_plate_comes_back_from_its_own_slot() -> None:
    for seed in range(3):
        state = CORNER.live_through(RUNS, seed)
        slots = [item.variables["slot"] for item in state.bench.labware.values()]
        assert len(set(slots)) == 2, "what stays has a slot, each its own"


def test_with_a_slot_that_is_not_the_devices_it_grips_empty_air(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("labos.core.decide.outcomes.reported", lambda value, result: "stacker4_slot22")
    assert any("grips empty air" in crash for crash in CORNER.crashes(RUNS, 0))
