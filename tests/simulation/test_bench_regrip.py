"""Where an arm changes its grip it puts the plate down: there has to be room. A bench on which a plate stands
there for a while, and the arm that sets another one onto it where the rule is off."""

from __future__ import annotations

import pytest

from labos.core import binding
from labos.core.ids import StationName
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.testing.faults import STORMY
from labos.testing.lab import make_bare_scheduler
from tests.simulation.corners import Corner
from tests.support.seeds import few_and_many

CORNER = Corner("""
labos: 1
name: corner
modules:
  - {name: left, model: sciclops}
  - {name: pf400, model: pf400, regrip: wc.regrip}
  - {name: reader, model: hidex}
stations:
  wc.regrip: {}
  wc.trash: {kind: waste}
stock:
  left.tower1: {plate96: 20}
""")

RESTS = CORNER.read("""
labos: 1
name: rests
steps:
  - {name: Get, module: left, action: get_plate, args: {loc: tower1}}
  - {name: Put, module: pf400, action: transfer, args: {source: left.exchange, target: wc.regrip}}
  - name: Away
    module: pf400
    action: transfer
    args: {source: wc.regrip, target: wc.trash}
    wait: [{after: Put, at_least: 30 min}]
""")
TURNS = CORNER.run(
    "turns",
    "left.get_plate loc=tower1",
    "pf400.transfer source=left.exchange target=reader.default "
    "source_plate_rotation=narrow target_plate_rotation=wide",
    "pf400.transfer source=reader.default target=wc.trash",
)
RUNS = [RESTS, TURNS, TURNS]


@few_and_many(1, 4)
def test_who_turns_its_grip_waits_until_there_is_room(seeds: range) -> None:
    for seed in seeds:
        CORNER.live_through(RUNS, seed)


@pytest.mark.slow
def test_in_a_storm_too() -> None:
    for seed in range(4):
        CORNER.live_through(RUNS, seed, STORMY)


def test_without_the_rule_it_sets_a_plate_onto_another(monkeypatch: pytest.MonkeyPatch) -> None:
    real = binding.check_room

    def room_at(state: LabState, place: StationName) -> Wait | None:
        return None if place == "corner/wc.regrip" else real(state, place)

    monkeypatch.setattr(binding, "check_room", room_at)
    # Beside the rule, the kernel refuses to write that two plates stand where there is room for one.
    monkeypatch.setattr("labos.runtime.kernel.find_broken_by", lambda state, events: "")
    for seed in range(4):
        crashes, _ = CORNER.run_anyhow(RUNS, seed, plan_with=make_bare_scheduler)
        assert any("at wc.regrip" in crash for crash in crashes), f"seed {seed}: {crashes}"
