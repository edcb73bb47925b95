"""Whole labs in virtual time in which most runs are due at some time: everybody comes to the end, and of one
user those come earlier that are due earlier."""

from __future__ import annotations

import random

import pytest
from msgspec.structs import replace

from labos.core.registry import decode
from labos.core.runs import RunCompleted, RunStarted, RunSubmitted
from labos.core.state import hash_state
from labos.testing.faults import QUIET, STORMY, FaultRates
from labos.testing.lab import Job, SimulatedLab
from labos.testing.loop import BASE_NS
from tests.simulation.invariants import fold_again
from tests.simulation.mixes import make_hurried, mix, pcr, stand

pytestmark = pytest.mark.timeout(300)
"""These tests compute for half a minute; on a busy computer they take several times as long."""

HOUR_NS = 3600 * 10**9
FIVE_DAYS_S = 5 * 24 * 3600.0


def with_due_dates(seed: int, jobs: list[Job]) -> list[Job]:
    """Four of five runs are due: some in the past, some in the middle of the work, some long after it."""
    rng = random.Random(f"due/{seed}")

    def due_at() -> int:
        return BASE_NS + int(rng.uniform(-1, 12) * HOUR_NS) if rng.random() < 0.8 else 0

    return [replace(job, runs=tuple(replace(run, due_at=due_at()) for run in job.runs)) for job in jobs]


def live_through(seed: int, jobs: list[Job], rates: FaultRates) -> None:
    lab = SimulatedLab(stand(), seed, rates)
    try:
        state = lab.run(with_due_dates(seed, jobs), limit_s=FIVE_DAYS_S)
        assert lab.differences(state) == [], f"seed {seed}"
        assert not state.runs.active
        assert not state.runs.queued
        faults = [fault for kernel in lab.opened for fault in kernel.faults]
        assert not faults, f"seed {seed}: {faults}"
        assert hash_state(fold_again(lab.store.records)) == hash_state(state)
    finally:
        lab.close()


@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    "seeds",
    [pytest.param(range(4), marks=pytest.mark.slow), pytest.param(range(4, 40), marks=pytest.mark.full)],
)
def test_everybody_comes_to_the_end(seeds: range) -> None:
    for seed in seeds:
        live_through(seed, mix(seed), QUIET if seed % 2 else STORMY)


@pytest.mark.slow
def test_nobody_with_a_window_waits_for_a_due_date() -> None:
    for seed in range(2):
        live_through(seed, make_hurried(seed), QUIET)


def test_who_is_due_first_is_let_in_first() -> None:
    lab = SimulatedLab(stand(), 1, QUIET)
    hours = [0, 9, 7, 8]
    jobs = [
        replace(job, runs=(replace(job.runs[0], due_at=BASE_NS + hours[n] * HOUR_NS if hours[n] else 0),))
        for n, job in enumerate(pcr(f"j{n}", "ada") for n in range(4))
    ]
    try:
        lab.run(jobs, limit_s=FIVE_DAYS_S)
        events = [decode(r.head.type, r.head.schema, r.payload) for r in lab.store.records]
        named = {e.run: e.due_at for e in events if isinstance(e, RunSubmitted)}
        begun = [named[e.run] for e in events if isinstance(e, RunStarted)]
        assert sum(isinstance(e, RunCompleted) for e in events) == 4
        rest = [due or 99 * BASE_NS for due in begun[1:]]  # the first came before the others were submitted
        assert rest == sorted(rest)
    finally:
        lab.close()
