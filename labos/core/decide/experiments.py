"""Experiments: an application begins, records notes, and ends."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from labos.core.closing import plan_closing
from labos.core.decide._base import Command, Decision, InnerCommand, Rejection, Report, decides
from labos.core.decide.endings import record_end
from labos.core.decide.lookups import decides_about, expect_experiment
from labos.core.decide.runs import find_plan_flaw, plan_digest, record_plan
from labos.core.decide.windows import list_outer_windows
from labos.core.experiments import (
    ExperimentClosing,
    ExperimentEnded,
    ExperimentNoted,
    ExperimentResumed,
    ExperimentStarted,
)
from labos.core.ids import ExperimentId, RunId, StationName, experiment_owner, local, user_owner
from labos.core.labware import LabwareHandedOver
from labos.core.model import Plan
from labos.core.open_experiments import Experiment, ExperimentStatus, note_digest
from labos.core.registry import Event
from labos.core.rules import CLOSING_S, find_late_close
from labos.core.runs import RunCancelled, RunSubmitted
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.topics import ClosingWaits, LostExperiment
from labos.core.words import Words


class StartExperiment(Command, frozen=True):
    """An application begins. ``closing`` is the workflow that clears away the labware that it parks between
    its runs. If ``parking`` names stations, it may park labware only there. ``propose``: it waits for an
    approval, even if the policy does not demand one."""

    name: str
    user: str
    closing: Plan | None = None
    priority: int = 0
    request: str = ""
    parking: tuple[StationName, ...] = ()
    propose: bool = False


class ResumeExperiment(Command, frozen=True):
    """An application that was started again continues its experiment. ``name`` is the application's own name
    for the experiment."""

    experiment: ExperimentId
    name: str


class NoteExperiment(Command, frozen=True):
    """An application records a note. A note with the same ``key`` is recorded only once."""

    experiment: ExperimentId
    kind: str
    name: str
    facts: dict[str, Any] = {}
    key: str = ""


class EndExperiment(Command, frozen=True):
    """The application has ended."""

    experiment: ExperimentId
    why: Words = "ended"


class AskAboutClosing(InnerCommand, frozen=True):
    """A closing workflow has not begun within its allowed waiting time."""

    run: RunId
    now: int


class LoseExperiment(Report, frozen=True):
    """The application sends no heartbeats."""

    experiment: ExperimentId
    why: str


NOTE_KINDS = (
    "loop_started",
    "loop_ended",
    "condition_checked",
    "decision",
    "local_compute",
    "compute",
    "flow",
    "publication",
    "transfer",
)


@decides(StartExperiment)
def start_experiment(state: LabState, command: StartExperiment) -> Decision:
    if command.request and command.request in state.experiments.requests:
        return []
    name = ExperimentId(f"E{state.experiments.named + 1}")
    for place in command.parking:
        if place not in state.bench.stations:
            return Rejection("no_station", f"There is no station {local(place)} to park at.")
    events: list[Event] = []
    closing = ""
    if command.closing is not None:
        flaw = find_plan_flaw(state, command.closing)
        if flaw:
            return flaw
        if list_outer_windows(command.closing):
            return Rejection(
                "no_anchor",
                f"The closing workflow {command.closing.workflow!r} has a window of another run.",
                "Anchor its windows at its own steps, because the time of its submission is not known.",
            )
        closing = plan_digest(command.closing)
        events += record_plan(state, command.closing, closing, name)
    events.append(
        make_from(
            ExperimentStarted,
            command,
            experiment=name,
            closing=closing,
            parking=tuple(dict.fromkeys(command.parking)),
        )
    )
    return events


@decides(ResumeExperiment)
def resume_experiment(state: LabState, command: ResumeExperiment) -> Decision:
    experiment = state.experiments.open.get(command.experiment)
    if experiment is None or experiment.status != ExperimentStatus.OPEN:
        is_so = "has ended, or never existed" if experiment is None else f"is {experiment.status}"
        return Rejection(
            "no_experiment",
            f"The experiment {command.experiment} cannot be resumed: it {is_so}.",
            "See its history: labos experiments --all",
        )
    if experiment.name != command.name:
        return Rejection(
            "other_experiment",
            f"The experiment {command.experiment} is {experiment.name!r}, not {command.name!r}.",
            "Find the right one: labos experiments",
        )
    return [ExperimentResumed(command.experiment)]


@decides_about(NoteExperiment, expect_experiment)
def note_experiment(state: LabState, command: NoteExperiment, experiment: Experiment) -> Decision:
    if command.kind not in NOTE_KINDS:
        return Rejection(
            "no_kind", f"{command.kind!r} is not a kind of note.", f"Known kinds: {', '.join(NOTE_KINDS)}."
        )
    known = experiment.notes.get(command.key) if command.key else None
    if known is None:
        return [make_from(ExperimentNoted, command)]
    if known == note_digest(command.kind, command.name, command.facts):
        return []
    return Rejection(
        "key_reused",
        f"The experiment {command.experiment} already has another note with the key {command.key!r}.",
        "Give each note its own key; use a key again only to repeat the same note.",
    )


@decides_about(EndExperiment, expect_experiment)
def end_experiment(state: LabState, command: EndExperiment, experiment: Experiment) -> Decision:
    if experiment.status == ExperimentStatus.CLOSING:
        return []
    if experiment.runs:
        return Rejection(
            "runs_alive",
            f"The experiment {command.experiment} still has runs: {', '.join(experiment.runs)}.",
            "Wait for them or cancel them first.",
        )
    return close_experiment(state, command.experiment, command.why)


@decides(LoseExperiment)
def lose_experiment(state: LabState, command: LoseExperiment) -> Decision:
    experiment = state.experiments.open.get(command.experiment)
    if (
        experiment is None
        or experiment.status != ExperimentStatus.OPEN
        or state.interventions.find_about(command.experiment)
    ):
        return []
    return [
        state.interventions.ask(
            LostExperiment(experiment=command.experiment),
            f"The application of {experiment.name} ({command.experiment}, {experiment.user}) is silent: "
            f"{command.why.rstrip('.')}.",
        )
    ]


@decides(AskAboutClosing)
def ask_about_closing(state: LabState, command: AskAboutClosing) -> Decision:
    run = state.runs.queued.get(command.run)
    due = find_late_close(state, run) if run is not None else None
    if run is None or due is None or command.now <= due:
        return []
    return [
        state.interventions.ask(
            ClosingWaits(run=run.id, user=run.user),
            f"The closing workflow of {run.experiment} ({run.id}, {run.workflow}) has not started in "
            f"{CLOSING_S / 60:g} minutes. `labos explain {run.id}` says what it waits for.",
        )
    ]


def end_without_closing(state: LabState, name: RunId) -> Iterator[Event]:
    """End an experiment without its closing workflow, which has not begun."""
    run = state.runs.queued.get(name)
    if run is not None:
        yield from record_end(state, run, RunCancelled(run.id), "was cancelled")


def close_experiment(state: LabState, name: ExperimentId, why: str) -> list[Event]:
    """Start the closing workflow of an experiment, with the steps that its labware needs. The experiment ends
    at once if it has no labware or no closing workflow, or if it was not approved."""
    experiment = state.experiments.open.get(name)
    if experiment is None or experiment.status == ExperimentStatus.CLOSING:
        return []
    owned = state.bench.list_owned(experiment_owner(name))
    plan = plan_closing(state, experiment) if owned and experiment.closing and not experiment.held else None
    if plan is not None:
        digest = plan_digest(plan)
        events = record_plan(state, plan, digest, name)
        return [
            ExperimentClosing(name, why),
            *events,
            RunSubmitted(
                run=RunId(f"R{state.runs.named + 1}"),
                plan=digest,
                workflow=plan.workflow,
                user=experiment.user,
                experiment=name,
                priority=experiment.priority,
                payload={},
                pins={},
                closing=True,
                planned_by=name if events else state.runs.find_plan_stream(digest),
            ),
        ]
    return _end(state, experiment, why)


def _end(state: LabState, experiment: Experiment, why: str = "") -> list[Event]:
    """End an experiment. Labware that was not cleared away goes to its user."""
    owned = state.bench.list_owned(experiment_owner(experiment.id))
    return [
        *(LabwareHandedOver(item.id, "", user_owner(experiment.user)) for item in owned),
        ExperimentEnded(experiment.id, experiment.closing, why),
    ]


# -- reactions -----------------------------------------------------------------------------------


def end_experiments(state: LabState, event: Event) -> Iterator[Event]:
    """A cancelled experiment closes when its last run has ended; a closing experiment ends when its closing
    workflow has ended."""
    for name in list(state.experiments.ending):
        experiment = state.experiments.open[name]
        if not experiment.runs and experiment.status == ExperimentStatus.CLOSING:
            yield from _end(state, experiment)
        elif not experiment.runs:
            yield from close_experiment(state, name, "it was cancelled")


def withdraw_experiment_question(
    state: LabState, event: ExperimentClosing | ExperimentEnded | ExperimentResumed
) -> Iterator[Event]:
    """The question about a silent application is withdrawn when the application comes back."""
    came_back = isinstance(event, ExperimentResumed)
    why = f"the application {'was started again' if came_back else 'came back and ended'}"
    for question in state.interventions.list_about(event.experiment):
        if isinstance(question.topic, LostExperiment) or not came_back:
            yield question.withdraw(why)
