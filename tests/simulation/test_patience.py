"""A whole lab in virtual time: a plate of low priority is overtaken for so long and no longer."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from msgspec.structs import replace

from labos.core.ids import RunId
from labos.core.runs import RunCompleted, RunState, RunSubmitted
from labos.core.state import LabState
from labos.planning.patience import OvertakeCounts
from labos.planning.scheduler import Scheduler, make_searching_scheduler
from labos.planning.wait_list import WaitList
from labos.planning.waiting import PATIENCE
from labos.testing.faults import QUIET
from labos.testing.lab import Job, SimulatedLab
from tests.simulation.mixes import compile_text, make_slow_reading, stand

YOUNGER = 20


class _Endless(OvertakeCounts):
    """Nobody inside was ever overtaken too often."""

    def is_over(self, run: RunId) -> bool:
        return False

    def find_run_that_goes_first(self, state: LabState, run: RunState, wait_list: WaitList) -> RunId | None:
        return None


def by_priority() -> Scheduler:
    """Planning by priority alone."""
    scheduler = Scheduler()
    scheduler.patience = _Endless()
    return scheduler


def count_overtaken(plan_with: Callable[[], Scheduler]) -> int:
    """How many of the younger runs of more priority end before a plate that waits for the same reader. One
    of them comes every ten minutes, and keeps the reader for longer than that."""
    dosed = compile_text("""
labos: 1
name: dosed, then read
steps:
  - {name: Get, module: sciclops, action: get_plate, args: {loc: tower2}}
  - name: In
    module: pf400
    action: transfer
    args: {source: sciclops.exchange, target: ot2_pcr_alpha.deck1_cooler}
  - {name: Dose, module: ot2_pcr_alpha, action: run_protocol, args: {config_path: p.yaml}}
  - name: Over
    module: pf400
    action: transfer
    args: {source: ot2_pcr_alpha.deck1_cooler, target: hidex.default}
  - {name: Shut, module: hidex, action: close_lid}
  - {name: Read, module: hidex, action: run_assay, args: {assay_name: od}}
  - {name: Open, module: hidex, action: open_lid}
  - {name: Away, module: pf400, action: transfer, args: {source: hidex.default, target: wc.trash}}
""")
    hurried = replace(make_slow_reading(), user="bo", priority=9)
    jobs = [Job("old", "ada", (replace(dosed, user="ada"),))]
    jobs += [Job(f"j{n}", "bo", (hurried,), after_s=30.0 + 600.0 * n) for n in range(YOUNGER)]
    lab = SimulatedLab(stand(), 1, QUIET, plan_with=plan_with)
    try:
        state = lab.run(jobs, limit_s=5 * 24 * 3600.0)
        assert not state.runs.active
        assert not state.runs.queued
        events = lab.store.records
        submitted = [r.head.stream for r in events if r.head.type == RunSubmitted.TYPE]
        ended = [r.head.stream for r in events if r.head.type == RunCompleted.TYPE]
        assert len(ended) == YOUNGER + 1
        return ended.index(submitted[0])
    finally:
        lab.close()


@pytest.mark.slow
def test_a_plate_inside_is_overtaken_for_so_long_and_no_longer() -> None:
    # One may be at the reader when its turn has come, and one on its way there.
    assert count_overtaken(make_searching_scheduler) <= PATIENCE + 2
    assert count_overtaken(by_priority) >= YOUNGER - 2
