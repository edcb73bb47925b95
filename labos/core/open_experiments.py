"""The experiments that have not ended, and the runs of each."""

from __future__ import annotations

from enum import StrEnum
from typing import Any

import msgspec

from labos.core.canonical import digest, encode_canonical
from labos.core.experiments import (
    ExperimentCancelled,
    ExperimentClosing,
    ExperimentEnded,
    ExperimentNoted,
    ExperimentStarted,
)
from labos.core.ids import ExperimentId, RunId, StationName
from labos.core.runs import REQUESTS_KEPT, RunEnd, RunSubmitted
from labos.core.structs import make_from


class ExperimentStatus(StrEnum):
    """``CANCELLED``: it closes when its runs have ended. ``CLOSING``: its closing workflow is under way."""

    OPEN = "open"
    CANCELLED = "cancelled"
    CLOSING = "closing"


class Experiment(msgspec.Struct):
    """``held``: it is not approved, and nothing of it is carried out. ``notes``: the digests of its notes, by
    key."""

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
    """``open`` are the experiments that have not ended; ``named`` and ``requests`` are as for runs.
    ``ending`` are those that were cancelled or are closing. ``members`` are the runs alive of experiments."""

    open: dict[ExperimentId, Experiment] = {}
    named: int = 0
    requests: dict[str, ExperimentId] = {}
    ending: dict[ExperimentId, bool] = {}
    members: dict[RunId, ExperimentId] = {}


def fold_experiment_started(experiments: Experiments, event: ExperimentStarted, at: int) -> None:
    experiments.named += 1
    if event.request:
        experiments.requests[event.request] = event.experiment
        while len(experiments.requests) > REQUESTS_KEPT:
            del experiments.requests[next(iter(experiments.requests))]
    experiments.open[event.experiment] = make_from(Experiment, event, id=event.experiment, started_at=at)


def fold_experiment_ending(
    experiments: Experiments, event: ExperimentCancelled | ExperimentClosing, at: int
) -> None:
    closes = isinstance(event, ExperimentClosing)
    status = ExperimentStatus.CLOSING if closes else ExperimentStatus.CANCELLED
    experiments.open[event.experiment].status = status
    experiments.ending[event.experiment] = True


def fold_experiment_ended(experiments: Experiments, event: ExperimentEnded, at: int) -> None:
    del experiments.open[event.experiment]
    experiments.ending.pop(event.experiment, None)


def fold_experiment_noted(experiments: Experiments, event: ExperimentNoted, at: int) -> None:
    experiment = experiments.open.get(event.experiment)
    if experiment is not None and event.key:
        experiment.notes[event.key] = note_digest(event.kind, event.name, event.facts)


def note_digest(kind: str, name: str, facts: dict[str, Any]) -> str:
    """A digest of a note, short enough to keep one for each note of an open experiment."""
    return digest(encode_canonical([kind, name, facts]))[:24]


def fold_run_submitted(experiments: Experiments, event: RunSubmitted, at: int) -> None:
    experiment = experiments.open.get(event.experiment)
    if experiment is not None:
        experiment.runs[event.run] = True
        experiments.members[event.run] = event.experiment


def fold_run_ended(experiments: Experiments, event: RunEnd, at: int) -> None:
    member = experiments.members.pop(event.run, None)
    experiment = experiments.open.get(member) if member is not None else None
    if experiment is not None:
        experiment.runs.pop(event.run, None)
