"""Steps that fail on a bench where the ways out cross each other: nobody is trapped, whatever fails."""

from __future__ import annotations

from collections import Counter

import pytest

from labos.core import branches, fold
from labos.core.decide.runs import SubmitRun
from labos.core.registry import decode
from labos.core.runs import PENDING, RunFailed, Runs
from labos.core.state import LabState
from labos.core.steps import StepRetried, fold_step_retried
from labos.planning import paths
from labos.testing.faults import QUIET, STORMY, FaultRates
from labos.testing.lab import SimulatedLab
from labos.testing.loop import Stalled
from tests.simulation.corners import jobs
from tests.simulation.moods import CORNER, GET, carry, make_crossing, make_sorted_out, run

CROSSING = [make_crossing("p", "q"), make_crossing("q", "p")] * 3


def live_through(
    runs: list, seed: int, rates: FaultRates = QUIET
) -> tuple[LabState, Counter[str], list[str]]:  # type: ignore[type-arg]
    """All runs to their ends: the bench and the log agree. Counts events; tells why runs failed."""
    lab = SimulatedLab(CORNER.stand, seed, rates)
    try:
        state = lab.run(jobs(runs), limit_s=12 * 3600.0)
        assert lab.differences(state) == [], f"seed {seed}"
        assert lab.world.crashes() == [], f"seed {seed}"
        assert not state.runs.active
        records = lab.store.records
        whys = [
            decode(r.head.type, r.head.schema, r.payload).why  # type: ignore[attr-defined]
            for r in records
            if r.head.type == RunFailed.TYPE
        ]
        return state, Counter(record.head.type for record in records), whys
    finally:
        lab.close()


def test_recovery_steps_are_carried_out_and_trap_nobody() -> None:
    """Who fails here has to go there, where another may be who has to come here."""
    recovered = 0
    for seed in range(3):
        _, count, whys = live_through(CROSSING, seed)
        recovered += count["step.recovering"]
        assert count["run.failed"] == count["step.recovering"]
        assert all("The press did not close" in why for why in whys)
        assert count["labware.removed"] == len(CROSSING), "every plate is thrown away"
    assert recovered > 4


def test_in_a_storm_too() -> None:
    live_through(CROSSING, 1, STORMY)


@pytest.mark.slow
def test_without_the_rule_they_trap_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutant: safety looks only at the way on which nothing fails."""
    monkeypatch.setattr(paths, "list_ways", lambda plan: branches.list_ways(plan)[:1])
    assert any(stalls(CROSSING, seed) for seed in range(6))


def stalls(runs: list[SubmitRun], seed: int) -> bool:
    try:
        live_through(runs, seed)
    except Stalled:
        return True
    return False


def test_a_person_says_what_becomes_of_a_step_that_failed() -> None:
    """Who walks by tries it again, leaves it out or gives it up."""
    asked = run(
        "asked",
        GET
        + carry("in", "tower.exchange", "p.nest")
        + "- {name: press, module: p, action: press, on_error: ask}\n"
        + carry("out", "p.nest", "wc.trash"),
    )
    total: Counter[str] = Counter()
    for seed in range(5):
        _, count, whys = live_through([asked] * 4, seed)
        total += count
        assert all("was given up by person" in why for why in whys)
    assert min(total["step.retried"], total["step.skipped"], total["run.failed"]) > 0
    assert total["run.completed"] + total["run.failed"] == 20


def test_what_can_be_left_out_is_skipped() -> None:
    skipped = run(
        "skipped",
        GET
        + carry("in", "tower.exchange", "p.nest")
        + "- {name: press, module: p, action: press, on_error: skip}\n"
        + carry("out", "p.nest", "wc.trash"),
    )
    _, count, _ = live_through([skipped] * 5, 2)
    assert count["run.completed"] == 5
    assert count["step.skipped"] == count["action.failed"] > 0


SORTED = [make_sorted_out("p", "q"), make_sorted_out("q", "p")] * 3


def test_results_decide_where_plates_go_and_trap_nobody() -> None:
    for seed in range(3):
        _, count, _ = live_through(SORTED, seed)
        assert count["run.completed"] == count["labware.removed"] == len(SORTED)
        assert len(SORTED) <= count["step.skipped"] <= 2 * len(SORTED), "one of two ways is left out"
    live_through(SORTED, 3, STORMY)


@pytest.mark.slow
def test_who_counts_on_one_branch_only_is_trapped(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutant: safety believes that every plate is weak."""
    monkeypatch.setattr(paths, "list_ways", lambda plan: branches.list_ways(plan)[:1])
    assert any(stalls(SORTED, seed) for seed in range(6))


def test_a_press_that_jams_is_reset_before_it_is_tried_again() -> None:
    for seed in range(3):
        _, count, _ = live_through(JAMMING, seed)
        assert count["step.retried"] > 0
        assert count["run.completed"] + count["run.failed"] == len(JAMMING)


def test_without_waiting_for_the_reset_it_breaks(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutant: the next try does not wait for the reset of its module."""
    handlers = [
        (name, _no_reset if handler is fold_step_retried else handler)
        for name, handler in fold.TABLE[StepRetried]
    ]
    monkeypatch.setitem(fold.TABLE, StepRetried, tuple(handlers))
    assert any("presses while it is jammed" in crash for crash in CORNER.crashes(JAMMING, 1))


def _no_reset(runs: Runs, event: StepRetried, at: int) -> None:
    run = runs.active[event.run]
    run.steps[event.step].status = PENDING
    run.steps[event.step].retries = event.number


JAMMING = [
    run(
        "jamming",
        GET
        + carry("in", "tower.exchange", "r.nest")
        + "- name: press\n  module: r\n  action: press\n  retry: {times: 5, reset: true}\n"
        + "  on_error: {then: go_on, run: [{name: unjam, module: r, action: reset}]}\n"
        + carry("out", "r.nest", "wc.trash"),
    )
] * 3


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_many_labs_whose_ways_out_cross() -> None:
    for seed in range(150):
        live_through(CROSSING, seed, STORMY if seed % 2 else QUIET)
        live_through(SORTED, seed, STORMY if seed % 2 else QUIET)
        live_through(JAMMING, seed, STORMY if seed % 2 else QUIET)
