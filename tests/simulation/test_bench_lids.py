"""Plates with lids in virtual time: nothing works on a plate with its lid on, no lid comes to lie on
another, nobody is trapped by a lid that is parked. And each of that happens where the rule is off.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import pytest

from labos.core import binding, effects
from labos.core.effects import Carrying
from labos.core.ids import StationName
from labos.core.waits import Wait
from labos.planning.scheduler import Scheduler, make_searching_scheduler
from labos.spec import compile_workflow, find_spec, parse_workcell, parse_workflow
from labos.spec.bench import BenchFile, Stock
from labos.testing.faults import QUIET, FaultRates
from labos.testing.lab import Job, SimulatedLab, Stand, make_bare_scheduler
from labos.testing.loop import Stalled
from tests.simulation.mixes import DESCRIPTIONS, NODES
from tests.support.seeds import few_and_many, quiet_and_stormy

SEEDS = range(6)
DAYS_S = 3 * 24 * 3600.0

TEXT = find_spec("workcells", "rpl").read_text(encoding="utf-8")
CELL = parse_workcell(
    TEXT.replace("stations:\n", "stations:\n  wc.lids: {accepts: [lid96]}\n", 1).replace(
        "    wc.output:", "    wc.lids: [170.0, -20.3, 262.4, 371.9, 80.5, 730.2]\n    wc.output:", 1
    ),
    DESCRIPTIONS,
)
STOCK = (Stock(StationName("rpl/sciclops.tower1"), "plate96+lid96", 20),)

READ = """
labos: 1
name: read a lidded plate
steps:
  - {name: Get, module: sciclops, action: get_plate, args: {loc: tower1}}
  - {name: Unlid, module: sciclops, action: remove_lid, args: {source: exchange, target: lidnest1}}
  - {name: In, module: pf400, action: transfer, args: {source: sciclops.exchange, target: hidex.default}}
  - {name: Shut, module: hidex, action: close_lid}
  - {name: Read, module: hidex, action: run_assay, args: {assay_name: od}}
  - {name: Open, module: hidex, action: open_lid}
  - {name: Out, module: pf400, action: transfer, args: {source: hidex.default, target: sciclops.exchange}}
  - {name: Relid, module: sciclops, action: replace_lid, args: {source: lidnest1, target: exchange}}
  - {name: Away, module: pf400, action: transfer, args: {source: sciclops.exchange, target: wc.trash}}
"""

DOSE = """
labos: 1
name: dose a lidded plate
steps:
  - {name: Get, module: sciclops, action: get_plate, args: {loc: tower1}}
  - {name: In, module: pf400, action: transfer, args: {source: sciclops.exchange, target: PLACE}}
  - {name: Dose, module: HANDLER, action: run_protocol, args: {config_path: p.yaml}, after: [In]}
  - {name: Unlid, module: pf400, action: remove_lid, args: {source: PLACE, target: wc.lids}, after: [In]}
  - name: Relid
    module: pf400
    action: replace_lid
    args: {source: wc.lids, target: PLACE}
    after: [Unlid, Dose]
  - {name: Away, module: pf400, action: transfer, args: {source: PLACE, target: wc.trash}, after: [Relid]}
"""
"""The author forgot that dosing has to wait for the lid: the rule knows it."""


@cache
def job(name: str, text: str, after_s: float = 0.0) -> Job:
    from labos.core.decide.runs import SubmitRun

    source = parse_workflow(text, "lids.yaml")
    compiled = compile_workflow(
        source, {}, CELL.workcell, DESCRIPTIONS, simulate=True, bench=BenchFile(STOCK)
    )
    return Job(name, "ada", (SubmitRun(compiled.plan, "ada"),), after_s=after_s)


def dose(handler: str, place: str) -> str:
    return DOSE.replace("PLACE", f"{handler}.{place}").replace("HANDLER", handler)


def jobs() -> list[Job]:
    """Three that park their lids at one nest, and three at another."""
    return [
        *(job(f"read{number}", READ, 60.0 * number) for number in range(3)),
        job("alpha", dose("ot2_pcr_alpha", "deck1_cooler")),
        job("beta", dose("ot2_growth_beta", "deck2"), 30.0),
        job("gamma", dose("ot2_cp_gamma", "deck2"), 90.0),
    ]


def laboratory(
    seed: int, rates: FaultRates = QUIET, plan_with: Callable[[], Scheduler] = make_searching_scheduler
) -> SimulatedLab:
    stock = tuple((s.station, s.labware, s.count) for s in STOCK)
    return SimulatedLab(Stand(CELL.workcell, stock, NODES), seed, rates, plan_with=plan_with)


@quiet_and_stormy
@few_and_many(1, 6)
def test_lids_come_off_and_on_and_nobody_works_on_them(rates: FaultRates, seeds: range) -> None:
    for seed in seeds:
        lab = laboratory(seed, rates)
        try:
            state = lab.run(jobs(), limit_s=DAYS_S)
            assert lab.differences(state) == [], f"seed {seed}"
            assert not state.runs.active
        finally:
            lab.close()


def crashes(seed: int, plan_with: Callable[[], Scheduler] = make_searching_scheduler) -> list[str]:
    """What went to pieces on the bench, whatever became of the runs."""
    lab = laboratory(seed, plan_with=plan_with)
    try:
        lab.run_for(jobs(), 3 * 3600.0)
    except Stalled:
        pass
    finally:
        found = [f"{m.facts['what']} at {m.place}" for m in lab.world.crashes()]
        lab.close()
    return found


@pytest.mark.slow
def test_without_the_rule_tips_are_driven_into_lids(monkeypatch: pytest.MonkeyPatch) -> None:
    assert crashes(0) == []
    monkeypatch.setattr(binding.StartCheck, "check_value", lambda *_: None)
    assert any("drives its tips into a lid" in crash for crash in crashes(0))


def test_without_room_lids_are_put_on_lids(monkeypatch: pytest.MonkeyPatch) -> None:
    real = binding.StartCheck.check_room

    def room_for_lids(self: binding.StartCheck, what: Carrying, place: StationName) -> Wait | None:
        item = self._find_item(what)
        return None if item is not None and item.type == "lid96" else real(self, what, place)

    monkeypatch.setattr(binding.StartCheck, "check_room", room_for_lids)
    monkeypatch.setattr(effects.Unlid, "room", property(lambda what: (what.via,) if what.via else ()))
    found = (crash for seed in SEEDS for crash in crashes(seed, make_bare_scheduler))
    assert any("puts a plate on a plate at sciclops.lidnest1" in crash for crash in found)


@pytest.mark.full
def test_without_safety_parked_lids_trap_somebody() -> None:
    """One waits at the exchange for the nest, the other has its lid there and cannot come back."""
    lab = laboratory(0, plan_with=make_bare_scheduler)
    try:
        with pytest.raises(Stalled):
            lab.run([job(f"read{number}", READ) for number in range(3)], limit_s=DAYS_S)
    finally:
        lab.close()
