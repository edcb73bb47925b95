"""Control of more than one run at a time: experiments, modules, workcells, the whole lab."""

from __future__ import annotations

from itertools import chain
from typing import Any

from labos.core.decide._base import Command, Decision, Rejection
from labos.core.decide.cancelling import cancel_all
from labos.core.decide.lookups import decides_about, expect_experiment
from labos.core.experiments import ExperimentCancelled
from labos.core.ids import ExperimentId, ModuleName
from labos.core.lab import WHOLE_LAB, StartsPaused, StartsResumed
from labos.core.open_experiments import Experiment, ExperimentStatus
from labos.core.repeated import record_repeat
from labos.core.runs import SETTLED, RunState
from labos.core.state import LabState
from labos.core.words import Words


class PauseStarts(Command, frozen=True):
    """Stop all starts of an experiment, on a module, in a workcell, or in the whole lab (``*``). Actions in
    flight continue to their end."""

    target: str
    by: str
    why: Words = ""


class ResumeStarts(Command, frozen=True):
    target: str
    by: str


class CancelRuns(Command, frozen=True):
    """Cancel the runs under way that still need a module; or all runs of a workcell, or of the whole lab
    (``*``), including those that wait. Closing workflows continue, because they clear labware away."""

    target: str
    stay: bool = False
    why: Words = ""


class CancelExperiment(Command, frozen=True):
    """Cancel all runs of an experiment. It takes no more runs, and closes when its runs have ended. With
    ``stay``, its closing workflow is cancelled too if it is under way: labware that is not cleared away
    stays."""

    experiment: ExperimentId
    by: str
    stay: bool = False
    why: Words = ""


def _expect_target(state: LabState, command: Any) -> str | Rejection:
    """A part of the lab whose starts can be paused."""
    target: str = command.target
    if (
        target == WHOLE_LAB
        or target in state.lab.workcells
        or ModuleName(target) in state.modules.by_name
        or ExperimentId(target) in state.experiments.open
    ):
        return target
    return Rejection(
        "no_target",
        f"There is no experiment, module or workcell {target!r}.",
        "List them: labos experiments, labos nodes",
    )


@decides_about(PauseStarts, _expect_target)
def pause_starts(state: LabState, command: PauseStarts, target: str) -> Decision:
    if command.target in state.lab.paused:
        return record_repeat(command.target, "pause", command.why)
    return [StartsPaused(command.target, command.by, command.why)]


@decides_about(ResumeStarts, _expect_target)
def resume_starts(state: LabState, command: ResumeStarts, target: str) -> Decision:
    return [StartsResumed(command.target, command.by)] if command.target in state.lab.paused else []


@decides_about(CancelRuns, _expect_target)
def cancel_runs(state: LabState, command: CancelRuns, target: str) -> Decision:
    runs = [*state.runs.active.values(), *state.runs.queued.values()]
    needing = [run.id for run in runs if _is_meant(state, run, command.target)]
    return cancel_all(state, needing, command.why, stay=command.stay)


@decides_about(CancelExperiment, expect_experiment)
def cancel_experiment(state: LabState, command: CancelExperiment, experiment: Experiment) -> Decision:
    if experiment.status != ExperimentStatus.OPEN:
        again = record_repeat(command.experiment, "cancel", command.why)
        runs = experiment.runs if command.stay else ()
        return chain(again, cancel_all(state, runs, command.why, stay=True))
    reason = f": {command.why}" if command.why else ""
    ended = ExperimentCancelled(command.experiment, f"cancelled by {command.by}{reason}")
    return chain([ended], cancel_all(state, experiment.runs, command.why, stay=command.stay))


def _is_meant(state: LabState, run: RunState, target: str) -> bool:
    if run.closing:
        return False
    plan = state.runs.plan_of(run)
    if target in (WHOLE_LAB, plan.workcell):
        return True
    left = zip(plan.steps, run.steps, strict=True) if run.has_started else ()
    return any(step.module == target and at.status not in SETTLED for step, at in left)
