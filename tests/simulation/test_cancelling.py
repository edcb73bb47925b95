"""Runs that are cancelled go their way out, whatever is in flight, and nobody else is kept from the end."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterable

import pytest

from labos.core.ids import local
from labos.core.state import LabState
from labos.testing.faults import QUIET, STORMY, FaultRates
from labos.testing.lab import Job, SimulatedLab, make_cancellers
from tests.simulation.mixes import mix, pcr, stand

STEPS = 14
"""Steps of the PCR itself."""


def live_through(
    jobs: list[Job], seed: int, cancels: dict[str, int], rates: FaultRates = QUIET
) -> tuple[LabState, SimulatedLab]:
    """Runs are cancelled when the step named has begun; all others come to their ends."""
    lab = SimulatedLab(stand(), seed, rates, meddles=make_cancellers(cancels))
    try:
        state = lab.run(jobs, limit_s=4 * 24 * 3600.0)
        assert lab.differences(state) == [], f"seed {seed}, {cancels}"
        assert lab.world.crashes() == [], f"seed {seed}, {cancels}"
        assert not state.interventions.open, f"seed {seed}, {cancels}"
        return state, lab
    finally:
        lab.close()


def counts(lab: SimulatedLab) -> Counter[str]:
    return Counter(record.head.type for record in lab.store.records)


def each_step(others: int, steps: Iterable[int] = range(STEPS)) -> None:
    """A PCR is cancelled with each of its steps in flight in turn, beside others that go on: it clears the
    bench, and nobody has to be asked."""
    for step in steps:
        jobs = [pcr(f"j{number}", "ada") for number in range(1 + others)]
        state, lab = live_through(jobs, step, {"j0/0": step})
        count = counts(lab)
        out = step < STEPS - 1  # with its last step it has come to its end
        assert count["run.cancelled"] == count["run.leaving"] == out, f"step {step}"
        assert count["run.completed"] == others + (not out)
        assert count["intervention.requested"] == 0
        places = {
            local(state.bench.find_planned_place(item.station)) for item in state.bench.labware.values()
        }
        assert places <= {"sciclops.tower2", "wc.output"}, f"step {step}: {places}"


@pytest.mark.slow
def test_a_pcr_that_is_cancelled_at_any_step_clears_the_bench() -> None:
    each_step(others=1, steps=range(1, STEPS, 3))


@pytest.mark.slow
def test_whoever_is_cancelled_keeps_nobody_from_the_end() -> None:
    mixes([4])


def mixes(seeds: Iterable[int], rates: FaultRates = QUIET) -> None:
    """Half of the PCRs of a mix are cancelled somewhere on their way."""
    left = 0
    for seed in seeds:
        dice = random.Random(seed)
        jobs = mix(seed)
        cancels = {
            f"{job.name}/0": dice.randrange(STEPS)
            for job in jobs
            if job.runs[0].plan.workflow == "pcr" and dice.random() < 0.5
        }
        left += counts(live_through(jobs, seed, cancels, rates)[1])["run.leaving"]
    print(f"{left} runs went their way out")
    assert left


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_forty_mixes_with_cancelled_runs() -> None:
    each_step(others=4)
    mixes(range(2, 30))
    mixes(range(30, 40), STORMY)
