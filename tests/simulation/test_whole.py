"""The bench as it really is, lived through by seed: no crash in ground truth, no trap, every stop named.

A failing seed is replayed by ``pytest tests/simulation/test_whole.py --seed N``. The whole campaign is
``-m full``, in parts of fifty: ``-k 'hundred and 150'`` lives through one of them.
"""

from __future__ import annotations

import random
from collections import Counter

import pytest

from labos.core.runs import RunLeaving, RunSubmitted
from labos.core.state import LabState, hash_state
from labos.planning.layout import lay_out
from labos.planning.safety import Safety
from labos.testing.faults import QUIET, STORMY, FaultRates
from labos.testing.lab import SimulatedLab, make_cancellers
from tests.simulation.invariants import fold_again
from tests.simulation.stops import causes
from tests.simulation.whole import FITS, MORTAL, cancels, mix, stand

pytestmark = pytest.mark.timeout(300)
"""These tests compute for half a minute; on a busy computer they take several times as long."""

CI_SEEDS = (0, 6, 8, 13, 19, 183)
"""Quiet and stormy, with modules that die, come back or do not."""
ALL_SEEDS = range(500)
PART = 50
WEEK_S = 7 * 24 * 3600.0
STILL_S = 9000.0
"""If nothing has happened for so long, nothing will."""


def weather(seed: int) -> tuple[FaultRates, dict[str, float], dict[str, float]]:
    """Quiet or stormy; which modules die and when (s), and after how long they come back."""
    rng = random.Random(f"weather/{seed}")
    rates = STORMY if rng.random() < 0.6 else QUIET
    doomed = {rng.choice(MORTAL): rng.uniform(300, 6000) for _ in range(rng.choice([0, 0, 1, 1, 2]))}
    mended = {name: rng.uniform(600, 5400) for name in doomed if rng.random() < 0.5}
    return rates, doomed, mended


def could_still_end(state: LabState) -> set[str]:
    """Who has a way to its end on the bench as it stands, whatever has died."""
    safety, cell = Safety(), stand().workcell.name
    actors = safety.list_actors(state, cell)
    return safety.find(lay_out(state, cell, actors, hopeful=False), actors, set())[1]


def live_through(seed: int) -> Counter[str]:
    """One seed until everything has ended or nothing goes on; what became of its runs."""
    rates, doomed, mended = weather(seed)
    jobs = mix(seed)
    asked = cancels(seed, jobs)
    lab = SimulatedLab(
        stand(), seed, rates, doomed=doomed, mended=mended, still_s=STILL_S, meddles=make_cancellers(asked)
    )
    lab.refills, lab.late = True, 0.7
    for place, grip in FITS.items():
        for kind in ("plate96", "pcr96"):
            lab.world.fit(place, kind, grip)
    try:
        state = lab.run_for(jobs, WEEK_S)
        wrong = lab.differences(state)
        assert not wrong, f"seed {seed}, {doomed}, {mended}: {wrong}"
        assert hash_state(fold_again(lab.store.records)) == hash_state(state)
        faults = [fault for kernel in lab.opened for fault in kernel.faults]
        assert not faults, f"seed {seed}: {faults}"
        submitted = sum(record.head.type == RunSubmitted.TYPE for record in lab.store.records)
        left = [*state.runs.active.values(), *state.runs.queued.values()]
        tally = Counter(seeds=1, submitted=submitted, ended=submitted - len(left), events=state.position)
        tally["jobs"] += len(jobs)
        tally["asked to cancel"] += len(asked)
        tally["went their way out"] += sum(r.head.type == RunLeaving.TYPE for r in lab.store.records)
        tally["jobs done"] += len(lab.done_jobs)
        tally["stormy"] += rates is STORMY
        tally["modules that died"] += len(doomed)
        tally["of them mended"] += len(mended)
        gone = {name for name in doomed if name not in mended}
        for run, stops in causes(state, left, lab.store.head().recorded_at).items():
            named = [stop for stop in stops if stop]
            assert named, f"seed {seed}: {run} stops and nothing is named; {lab.report()}"
            tally.update(f"stopped by {stop.partition(',')[0]}" for stop in set(named))
        trapped = could_still_end(state) & {str(run) for run in state.runs.active}
        assert not trapped, f"seed {seed}: {trapped} could come to their ends; {lab.report()}"
        if not gone:
            assert not left, f"seed {seed}: {lab.report()}"
            assert len(lab.done_jobs) == len(jobs), f"seed {seed}: {lab.report()}"
        return tally
    finally:
        lab.close()


@pytest.mark.slow
def test_the_whole_bench(request: pytest.FixtureRequest) -> None:
    one = request.config.getoption("--seed")
    total: Counter[str] = Counter()
    for seed in CI_SEEDS if one is None else (one,):
        total += live_through(seed)
    print(dict(total))


@pytest.mark.full
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("first", ALL_SEEDS[::PART])
def test_five_hundred(first: int) -> None:
    total: Counter[str] = Counter()
    for seed in range(first, first + PART):
        total += live_through(seed)
    print(f"seeds {first} to {first + PART - 1}: {dict(total)}")
