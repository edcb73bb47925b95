"""Somebody pauses, stops or cancels something while each step of the PCR is in flight in turn."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import pytest

from labos.core.actions import ActionRequested
from labos.core.decide import Command
from labos.core.decide.control import CancelExperiment, CancelRuns, PauseStarts, ResumeStarts
from labos.core.decide.experiments import StartExperiment
from labos.core.decide.nodes import PutBack, TakeOut
from labos.core.decide.runs import PauseRun, ResumeRun
from labos.core.envelope import Record
from labos.core.ids import ExperimentId, ModuleName, RunId, local
from labos.core.registry import decode
from labos.testing.faults import QUIET, STORMY, FaultRates
from labos.testing.lab import Job, Meddle, SimulatedLab
from tests.simulation.mixes import PLANS, pcr, stand

STEPS = 14
"""Steps of the PCR itself."""

CELL = stand().workcell.name
HOUR_S = 3600.0

Deed = tuple[float, Command | str]
Deeds = Callable[[RunId], Sequence[Deed]]
Told = list[tuple[str, int, str]]
"""Events: their types, when they were recorded (UTC ns), and their streams."""


def live_through(
    step: int, deeds: Deeds, jobs: Sequence[Job], rates: FaultRates = QUIET
) -> tuple[Counter[str], Told]:
    """The first PCR is meddled with when this step has begun. Counts events, and tells of each."""
    lab = SimulatedLab(stand(), step, rates, meddles=[Meddle("j0/0", step, deeds)])
    try:
        state = lab.run(jobs, limit_s=3 * 24 * HOUR_S)
        assert lab.differences(state) == [], f"step {step}"
        assert lab.world.crashes() == [], f"step {step}"
        assert not state.interventions.open, f"step {step}"
        places = {
            local(state.bench.find_planned_place(item.station)) for item in state.bench.labware.values()
        }
        assert places <= {"sciclops.tower2", "wc.output"}, f"step {step}: {places}"
        heads = [record.head for record in lab.store.records if not is_sent_again(record)]
        told = [(head.type, head.recorded_at, head.stream) for head in heads]
        return Counter(head.type for head in heads), told
    finally:
        lab.close()


def two() -> list[Job]:
    return [pcr("j0", "ada"), pcr("j1", "bo")]


def one_in_an_experiment() -> list[Job]:
    return [Job("j0", "ada", (PLANS["pcr"],), StartExperiment("app", "ada")), pcr("j1", "bo")]


def is_sent_again(record: Record) -> bool:
    """Whether it is another attempt at what is in flight: its node has never heard of the one before."""
    if record.head.type != ActionRequested.TYPE:
        return False
    event = decode(record.head.type, record.head.schema, record.payload)
    return isinstance(event, ActionRequested) and event.attempt > 1


def still(told: Told, begins: str, ends: str, run: str = "") -> bool:
    """Whether no action was asked for, of a run if one is named, between two kinds of event."""
    begun = [at for kind, at, _ in told if kind == begins]
    ended = [at for kind, at, _ in told if kind == ends]
    return not any(
        kind == "action.requested" and run in ("", stream) and start < at < end
        for start, end in zip(begun, ended, strict=False)
        for kind, at, stream in told
    )


MODULES = ("pf400", "biometra", "ot2_pcr_alpha")

PAUSES: dict[str, Deeds] = {
    "the run": lambda run: [(0.0, PauseRun(run)), (HOUR_S, ResumeRun(run))],
    "the experiment": lambda run: [
        (0.0, PauseStarts("E1", "ada")),
        (HOUR_S, ResumeStarts("E1", "ada")),
    ],
    "the workcell": lambda run: [
        (0.0, PauseStarts(CELL, "ada")),
        (HOUR_S, ResumeStarts(CELL, "ada")),
    ],
    "the lab": lambda run: [(0.0, PauseStarts("*", "ada")), (HOUR_S, ResumeStarts("*", "ada"))],
    **{
        name: lambda run, module=f"{CELL}/{name}": [
            (0.0, PauseStarts(module, "ada")),
            (HOUR_S, ResumeStarts(module, "ada")),
        ]
        for name in MODULES
    },
    "out of service": lambda run: [
        (0.0, TakeOut(ModuleName(f"{CELL}/pf400"), "belt")),
        (HOUR_S, PutBack(ModuleName(f"{CELL}/pf400"))),
    ],
}


def pauses(steps: Sequence[int], names: Sequence[str], rates: FaultRates = QUIET) -> None:
    """Everything comes to its end when it goes on, and nothing was started meanwhile where it should not."""
    for step in steps:
        for name in names:
            jobs = one_in_an_experiment() if name == "the experiment" else two()
            met: list[RunId] = []

            def deeds(run: RunId, name: str = name, met: list[RunId] = met) -> Sequence[Deed]:
                met.append(run)
                return PAUSES[name](run)

            count, told = live_through(step, deeds, jobs, rates)
            assert count["run.completed"] == 2, f"step {step}, {name}"
            if name in ("the workcell", "the lab") and count["starts.paused"]:
                assert still(told, "starts.paused", "starts.resumed"), f"step {step}, {name}"
            if name == "the experiment":
                assert count["experiment.ended"] == count["starts.paused"] == 1, f"step {step}"
                assert still(told, "starts.paused", "starts.resumed", met[0]), f"step {step}, {name}"


@pytest.mark.slow
def test_what_is_paused_goes_on() -> None:
    cells = ((1, "the run"), (4, "the experiment"), (5, "the lab"), (7, "biometra"), (9, "out of service"))
    for step, name in cells:
        pauses([step], [name])


def cancel_workcell(step: int, rates: FaultRates = QUIET) -> None:
    count, _ = live_through(step, lambda run: [(0.0, CancelRuns(CELL))], two(), rates)
    assert count["run.cancelled"] + count["run.completed"] == 2
    assert count["run.cancelled"]


def cancel_module(step: int) -> None:
    """Both still need the camera, if they are under way by then."""
    deeds: Deeds = lambda run: [(0.0, CancelRuns(f"{CELL}/camera_module"))]  # noqa: E731
    count, _ = live_through(step, deeds, two())
    assert count["run.cancelled"] + count["run.completed"] == 2
    assert bool(count["run.cancelled"]) or step > 11


def cancel_experiment(step: int) -> None:
    deeds: Deeds = lambda run: [(0.0, CancelExperiment(ExperimentId("E1"), "ada"))]  # noqa: E731
    count, _ = live_through(step, deeds, one_in_an_experiment())
    assert count["experiment.cancelled"] == count["experiment.ended"] == 1
    assert count["run.completed"] == 1 + (step == STEPS - 1)


def stop_the_arm(step: int, rates: FaultRates = QUIET) -> None:
    """In the middle of whatever is going on; a person looks, answers and resets."""
    lab = SimulatedLab(
        stand(), step, rates, meddles=[Meddle("j0/0", step, lambda run: [(0.0, f"{CELL}/pf400")])]
    )
    lab.tidies = True
    try:
        state = lab.run(two(), limit_s=3 * 24 * HOUR_S)
        assert lab.differences(state) == [], f"step {step}"
        assert lab.world.crashes() == [], f"step {step}"
        kinds = Counter(record.head.type for record in lab.store.records)
        assert kinds["run.completed"] + kinds["run.failed"] >= 2
        assert kinds["module.emergency_stopped"] == 1
    finally:
        lab.close()


def test_what_is_cancelled_clears_the_bench() -> None:
    cancel_workcell(3)
    cancel_module(6)
    cancel_experiment(9)


def test_an_arm_is_stopped_in_mid_motion() -> None:
    stop_the_arm(5)


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_every_kind_of_control_at_every_step() -> None:
    pauses(range(STEPS), list(PAUSES))
    for step in range(STEPS):
        cancel_workcell(step)
        cancel_module(step)
        cancel_experiment(step)
        stop_the_arm(step)
    for step in range(0, STEPS, 3):
        pauses([step], list(PAUSES), STORMY)
        cancel_workcell(step, STORMY)
        stop_the_arm(step, STORMY)
