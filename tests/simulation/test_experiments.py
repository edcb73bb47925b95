"""Applications that park plates, fall silent and are closed: nothing stays in anybody's way."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from labos.core.decide._base import DECIDERS
from labos.core.decide.experiments import LoseExperiment, StartExperiment
from labos.core.ids import ExperimentId, StationName
from labos.core.state import LabState
from labos.testing.faults import QUIET, STORMY, FaultRates
from labos.testing.lab import Job, SimulatedLab
from tests.simulation.mixes import PLANS, pcr, stand

PARKING = (StationName("rpl/ot2_cp_gamma.deck2"), StationName("rpl/camera_module.plate_station"))
TWO_DAYS_S = 2 * 24 * 3600.0


class Silent(SimulatedLab):
    """Its applications die after their last run and never end their experiment."""

    async def _act_as_user(self, job: Job) -> None:
        if job.experiment is None:
            return await super()._act_as_user(job)
        request = f"{job.name}/experiment"
        start = replace(job.experiment, request=request)
        await self._insist(start, lambda state: request in state.experiments.requests)
        name = self.fold_log().experiments.requests[request]
        for number, run in enumerate(job.runs):
            key = f"{job.name}/{number}"
            await self._insist(
                replace(run, request=key, experiment=name),
                lambda state, key=key: key in state.runs.requests,  # type: ignore[misc]
            )
            run_id = self.fold_log().runs.requests[key]
            await self._await(lambda state, run_id=run_id: state.runs.get(run_id) is None)  # type: ignore[misc]
        lost = LoseExperiment(ExperimentId(name), "no heartbeat")
        await self._insist(lost, lambda state: is_asked_or_over(state, name))
        await self._await(lambda state: name not in state.experiments.open)
        self.done_jobs.add(job.name)
        return None


def is_asked_or_over(state: LabState, name: ExperimentId) -> bool:
    found = state.experiments.open.get(name)
    return found is None or found.status != "open" or state.interventions.find_about(name) is not None


def application(name: str, mixes: int, after_s: float) -> Job:
    runs = tuple(replace(PLANS[w], user="ada") for w in ["cp_newplate", *["cp_mixcolor"] * mixes])
    start = StartExperiment("colour picker", "ada", PLANS["cp_trashplate"].plan, parking=PARKING)
    return Job(name, "ada", runs, start, after_s=after_s)


@pytest.mark.slow
@pytest.mark.parametrize("rates", [QUIET, STORMY], ids=["quiet", "storm"])
def test_silent_applications_are_closed_and_cleared_away(rates: FaultRates) -> None:
    closed = 0
    for seed in range(4):
        lab = Silent(stand(), seed, rates)
        try:
            jobs = [application("first", 1, 0.0), application("second", 0, 300.0), pcr("third", "bo", 60.0)]
            state = lab.run(jobs, limit_s=TWO_DAYS_S)
            assert lab.differences(state) == [], f"seed {seed}"
            assert state.experiments.open == {}
            assert not [o for o in state.bench.by_owner if o.startswith("experiment:")]
            closed += [record.head.type for record in lab.store.records].count("experiment.closing")
        finally:
            lab.close()
    assert closed > 0


def find_left_standing(seed: int) -> list[str]:
    """Experiments that still have plates on the bench long after their applications fell silent."""
    lab = Silent(stand(), seed, QUIET)
    try:
        state = lab.run_for([application("first", 1, 0.0), application("second", 0, 300.0)], 6000.0)
        assert lab.differences(state) == []
        return [owner for owner in state.bench.by_owner if owner.startswith("experiment:")]
    finally:
        lab.close()


@pytest.mark.slow
def test_unheard_of_silence_leaves_plates_in_the_way(monkeypatch: pytest.MonkeyPatch) -> None:
    assert [find_left_standing(seed) for seed in range(2)] == [[], []]
    monkeypatch.setitem(DECIDERS, LoseExperiment, lambda state, command: [])
    assert all(find_left_standing(seed) for seed in range(2))
