"""The experiments that have not ended, and the runs of each."""

from __future__ import annotations

from enum import StrEnum
from typing import Any

import msgspec

from labos.core.canonical import canonical, digest
from labos.core.experiments import (
    ExperimentCancelled,
    ExperimentClosing,
    ExperimentEnded,
    ExperimentNoted,
    ExperimentStarted,
)
from labos.core.ids import ExperimentId, RunId, StationName
from labos.core.runs import REQUESTS_KEPT, RunCancelled, RunCompleted, RunFailed, RunSubmitted


class ExperimentStatus(StrEnum):
    """One that was ``CANCELLED`` closes when its runs have ended; one that is ``CLOSING`` carries out its
    closing workflow."""

    OPEN = "open"
    CANCELLED = "cancelled"
    CLOSING = "closing"


class Experiment(msgspec.Struct):
    """``held``: it was not approved; nothing of it is carried out. ``notes``: what was noted under each key,
    as a digest."""

    id: ExperimentId
    name: str
    user: str
    closing: str
    priority: int
    started_at: int
    status: ExperimentStatus = ExperimentStatus.OPEN
    runs: dict[RunId, bool] = {}
    parking: tuple[StationName, ...] = ()
    held: bool = False
    notes: dict[str, str] = {}


class Experiments(msgspec.Struct):
    """``open`` are those that have not ended; ``named`` and ``requests`` as for runs. ``ending`` are those
    that were cancelled or are closing, ``members`` the runs alive of experiments."""

    open: dict[ExperimentId, Experiment] = {}
    named: int = 0
    requests: dict[str, ExperimentId] = {}
    ending: dict[ExperimentId, bool] = {}
    members: dict[RunId, ExperimentId] = {}


def started(experiments: Experiments, event: ExperimentStarted, at: int) -> None:
    experiments.named += 1
    if event.request:
        experiments.requests[event.request] = event.experiment
        while len(experiments.requests) > REQUESTS_KEPT:
            del experiments.requests[next(iter(experiments.requests))]
    experiments.open[event.experiment] = Experiment(
        id=event.experiment,
        name=event.name,
        user=event.user,
        closing=event.closing,
        priority=event.priority,
        started_at=at,
        parking=event.parking,
    )


def cancelled(experiments: Experiments, event: ExperimentCancelled, at: int) -> None:
    experiments.open[event.experiment].status = ExperimentStatus.CANCELLED
    experiments.ending[event.experiment] = True


def closing(experiments: Experiments, event: ExperimentClosing, at: int) -> None:
    experiments.open[event.experiment].status = ExperimentStatus.CLOSING
    experiments.ending[event.experiment] = True


def ended(experiments: Experiments, event: ExperimentEnded, at: int) -> None:
    del experiments.open[event.experiment]
    experiments.ending.pop(event.experiment, None)


def noted(experiments: Experiments, event: ExperimentNoted, at: int) -> None:
    experiment = experiments.open.get(event.experiment)
    if experiment is not None and event.key:
        experiment.notes[event.key] = note_digest(event.kind, event.name, event.facts)


def note_digest(kind: str, name: str, facts: dict[str, Any]) -> str:
    """What was noted, short enough to be kept for each note of an experiment that has not ended."""
    return digest(canonical([kind, name, facts]))[:24]


def submitted(experiments: Experiments, event: RunSubmitted, at: int) -> None:
    experiment = experiments.open.get(event.experiment)
    if experiment is not None:
        experiment.runs[event.run] = True
        experiments.members[event.run] = event.experiment


def run_left(experiments: Experiments, event: RunCompleted | RunFailed | RunCancelled, at: int) -> None:
    member = experiments.members.pop(event.run, None)
    experiment = experiments.open.get(member) if member is not None else None
    if experiment is not None:
        experiment.runs.pop(event.run, None)


HANDLERS = {
    ExperimentStarted: started,
    ExperimentCancelled: cancelled,
    ExperimentClosing: closing,
    ExperimentEnded: ended,
    ExperimentNoted: noted,
    RunSubmitted: submitted,
    RunCompleted: run_left,
    RunFailed: run_left,
    RunCancelled: run_left,
}
