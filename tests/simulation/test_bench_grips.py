"""An arm holds labware only as its fingers get round it: what comes off a stack is known only when
it is there, and the bench breaks where the rule is off."""

from __future__ import annotations

import pytest

from labos.core import binding
from labos.core.decide.runs import SubmitRun
from labos.core.ids import StationName, local
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.spec import compile_workflow, find_spec, parse_workcell, parse_workflow
from labos.spec.bench import BenchFile, Stock
from labos.testing.faults import QUIET
from labos.testing.lab import Job, SimulatedLab, Stand
from tests.simulation.mixes import DESCRIPTIONS, NODES

CELL = parse_workcell(
    find_spec("workcells", "rpl")
    .read_text(encoding="utf-8")
    .replace(
        "stations:\n",
        "stations:\n  hidex.default: {reach: {pf400: {plate96: [narrow, wide], pcr96: [narrow]}}}\n",
        1,
    )
    .replace("accepts: [plate96]", "accepts: [plate96, pcr96]"),
    DESCRIPTIONS,
)
STOCK = tuple(Stock(StationName("rpl/sciclops.tower1"), kind, 1) for kind in ("pcr96", "plate96", "plate96"))
"""A tower that somebody filled with both."""

READ = """
labos: 1
name: look and read
steps:
  - {name: Get, module: sciclops, action: get_plate, args: {loc: tower1}}
  - name: Look
    module: pf400
    action: transfer
    args: {source: sciclops.exchange, target: camera_module.plate_station}
  - name: In
    module: pf400
    action: transfer
    args: {source: camera_module.plate_station, target: hidex.default, target_plate_rotation: wide}
  - {name: Shut, module: hidex, action: close_lid}
  - {name: Read, module: hidex, action: run_assay, args: {assay_name: od}}
  - {name: Open, module: hidex, action: open_lid}
  - {name: Away, module: pf400, action: transfer, args: {source: hidex.default, target: wc.trash}}
"""


def job(name: str, after_s: float) -> Job:
    source = parse_workflow(READ, "grips.yaml")
    compiled = compile_workflow(
        source, {}, CELL.workcell, DESCRIPTIONS, simulate=True, bench=BenchFile(STOCK)
    )
    return Job(name, "ada", (SubmitRun(compiled.plan, "ada"),), after_s=after_s)


def live_through(seed: int) -> tuple[LabState, list[str]]:
    """Three runs; the last plate of the tower cannot be held wide at the reader."""
    stock = tuple((s.station, s.labware, s.count) for s in STOCK)
    lab = SimulatedLab(Stand(CELL.workcell, stock, NODES), seed, QUIET)
    lab.world.fit("hidex.default", "pcr96", "narrow")
    lab.world.fit("hidex.default", "plate96", "narrow", "wide")
    lab.world.fit("camera_module.plate_station", "pcr96", "narrow")
    lab.world.fit("camera_module.plate_station", "plate96", "narrow")
    try:
        state = lab.run_for([job(f"j{number}", 1200.0 * number) for number in range(3)], 3 * 3600.0)
        return state, [f"{m.facts['what']} at {m.place}" for m in lab.world.crashes()]
    finally:
        lab.close()


@pytest.mark.slow
def test_who_cannot_be_held_waits_and_says_why() -> None:
    for seed in range(3):
        state, crashes = live_through(seed)
        assert crashes == []
        (run,) = state.runs.active.values()
        step = next(i for i, s in enumerate(state.runs.plan_of(run).steps) if s.key == "In")
        found = binding.bind(state, run, state.runs.plan_of(run).steps[step])
        assert isinstance(found, Wait)
        assert found.blocked
        assert found.reason.sentence == "pf400 cannot hold pcr96 wide at hidex.default, only narrow"


def test_the_grip_that_a_station_leaves_is_chosen_and_changed_on_the_way() -> None:
    (run,) = job("one", 0.0).runs
    look, into = run.plan.steps[1].effects[0], run.plan.steps[2].effects[0]
    assert run.plan.steps[1].args["target_plate_rotation"] == "narrow"
    assert look.via == ""  # type: ignore[union-attr]
    assert local(into.via) == "wc.regrip"  # type: ignore[union-attr]


def test_without_the_rule_fingers_hit_the_plate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(binding, "check_grip", lambda *_: None)
    crashes = (crash for seed in range(3) for crash in live_through(seed)[1])
    assert any("rams its wide fingers into a plate at hidex.default" in crash for crash in crashes)
