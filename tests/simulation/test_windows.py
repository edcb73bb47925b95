"""Whole labs with clocks running: reservations keep windows that would be breached without them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import pytest

from labos.core.actions import ActionSucceeded
from labos.core.interventions import InterventionRequested
from labos.core.registry import Event, decode
from labos.core.runs import RunFailed, RunState
from labos.core.state import LabState
from labos.core.topics import LateStep
from labos.core.waits import Wait
from labos.planning.reservations import Reservations
from labos.planning.scheduler import Scheduler, make_searching_scheduler
from labos.testing.faults import QUIET, STORMY, FaultRates
from labos.testing.lab import Job, SimulatedLab
from tests.simulation.mixes import make_dosed_and_read, make_hurried, stand
from tests.support.seeds import few_and_many

pytestmark = pytest.mark.timeout(300)
"""These tests compute for half a minute; on a busy computer they take several times as long."""

KEPT = (RunFailed.TYPE, InterventionRequested.TYPE)
TWO_DAYS_S = 2 * 24 * 3600.0


class _Careless(Reservations):
    """Leaves no room for anybody."""

    def check_start(self, state: LabState, run: RunState, step: int, now: int) -> Wait | None:
        return None


def careless() -> Scheduler:
    """Planning with reservations switched off; deadlines still decide who goes first."""
    scheduler = Scheduler()
    scheduler.reservations = _Careless(scheduler.safety, {})
    return scheduler


def live_through(
    jobs: list[Job],
    seed: int,
    rates: FaultRates = QUIET,
    plan_with: Callable[[], Scheduler] = make_searching_scheduler,
) -> tuple[Counter[str], list[Event]]:
    """One seed to its end; the bench and the log agree in every plate. Counts events by type and
    keeps what was asked and how runs failed."""
    lab = SimulatedLab(stand(), seed, rates, plan_with=plan_with)
    try:
        state = lab.run(jobs, limit_s=TWO_DAYS_S)
        assert lab.differences(state) == [], f"seed {seed}"
        assert not state.runs.active
        assert not state.runs.queued
        assert not state.runs.windowed
        records = lab.store.records
        told = [decode(r.head.type, r.head.schema, r.payload) for r in records if r.head.type in KEPT]
        return Counter(record.head.type for record in records), told
    finally:
        lab.close()


def compare(seeds: range) -> tuple[int, int, int]:
    """Windows in all, windows breached, windows breached with reservations switched off."""
    windows = kept = lost = 0
    for seed in seeds:
        jobs = make_hurried(seed)
        windows += sum(bool(step.windows) for job in jobs for run in job.runs for step in run.plan.steps)
        kept += live_through(jobs, seed)[0]["window.breached"]
        lost += live_through(jobs, seed, plan_with=careless)[0]["window.breached"]
    print(f"of {windows} windows: {kept} breached, {lost} with reservations switched off")
    return windows, kept, lost


@pytest.mark.slow
def test_reservations_keep_windows_that_would_be_breached_without_them() -> None:
    """Of 36 windows in 8 seeds none is breached, and 12 with reservations switched off. Of 73 in
    16 seeds: none, and 34."""
    windows, kept, lost = compare(range(4))
    print(f"{windows} windows: {kept} breached, {lost} without reservations")
    assert windows > 8
    assert lost >= 4
    assert kept <= lost // 4


@pytest.mark.slow
def test_in_a_storm_nothing_is_lost_and_nobody_stands_still() -> None:
    for seed in range(4):
        live_through(make_hurried(seed), seed, STORMY)


@pytest.mark.slow
def test_the_log_says_when_the_device_was_done() -> None:
    """Results are late in a storm, and now and then pulled much later; their times are not."""
    late_ns = []
    for seed in range(3):
        lab = SimulatedLab(stand(), seed, STORMY)
        try:
            lab.run(make_hurried(seed), limit_s=TWO_DAYS_S)
            for record in lab.store.records:
                event = decode(record.head.type, record.head.schema, record.payload)
                if isinstance(event, ActionSucceeded):
                    assert 0 < event.ended_ns <= record.head.recorded_at
                    late_ns.append(record.head.recorded_at - event.ended_ns)
        finally:
            lab.close()
    assert max(late_ns) > 1_000_000_000


def count_breaches(on_breach: str, seeds: range) -> tuple[int, list[Event], Counter[str]]:
    """Breaches, made likely by planning that leaves no room, and what came of them."""
    told: list[Event] = []
    count: Counter[str] = Counter()
    for seed in seeds:
        counted, kept = live_through(make_hurried(seed, on_breach), seed, plan_with=careless)
        told += kept
        count += counted
    assert count["window.breached"] > 0
    return count["window.breached"], told, count


@pytest.mark.slow
def test_a_breach_may_be_no_more_than_an_event() -> None:
    _, told, _ = count_breaches("continue", range(2, 4))
    assert told == []


@pytest.mark.slow
def test_a_breach_may_fail_its_run() -> None:
    breaches, told, _ = count_breaches("fail", range(2, 4))
    failed = [event for event in told if isinstance(event, RunFailed)]
    assert len(failed) == breaches
    assert all("did not start within 240 s of the end of 'Dose'" in event.why for event in failed)


@pytest.mark.slow
def test_a_breach_may_ask_and_either_answer_leads_on() -> None:
    breaches, told, count = count_breaches("ask", range(2, 5))
    asked = [e for e in told if isinstance(e, InterventionRequested) and e.kind == LateStep.KIND]
    failed = [event for event in told if isinstance(event, RunFailed)]
    assert len(asked) == breaches
    assert 0 < len(failed) < breaches, "of the answers some give up and some go on"
    assert count["run.resumed"] == breaches - len(failed)


@few_and_many(1, 3)
def test_a_run_is_in_time_after_a_run_before_it(seeds: range) -> None:
    """The second run of an experiment waits twenty minutes from a step of the first; others want the
    reader meanwhile. It is in time only where room is kept for it."""
    late = Counter[str]()
    for name, plan_with in (("reserved", make_searching_scheduler), ("careless", careless)):
        for seed in seeds:
            others = [job for job in make_hurried(seed) if "timed" not in job.runs[0].plan.workflow]
            jobs = [make_dosed_and_read("x", "ada", after_s=600.0), *others]
            late[name] += live_through(jobs, seed, plan_with=plan_with)[0]["window.breached"]
    print(f"breaches of a clock of another run: {dict(late)}")
    assert late["reserved"] == 0


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_a_hundred_labs_in_a_hurry() -> None:
    windows, kept, lost = compare(range(100))
    assert lost > windows // 5
    assert kept <= lost // 4
