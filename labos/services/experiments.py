"""Experiments as the log shows them."""

from __future__ import annotations

import msgspec

from labos.core.experiments import (
    ExperimentCancelled,
    ExperimentClosing,
    ExperimentEnded,
    ExperimentNoted,
    ExperimentStarted,
)
from labos.core.lab import StartsPaused, StartsResumed
from labos.core.runs import RunCancelled, RunCompleted, RunFailed, RunSubmitted
from labos.core.structs import make_from
from labos.ports import LogQuery
from labos.services.log import Log, decode_events

TYPES = ("experiment", "run", "starts")


class ExperimentHistory(msgspec.Struct):
    """``status``: open, paused, cancelled, closing or ended. Times in UTC ns, 0 if not yet; ``runs`` by
    status (alive, completed, failed, cancelled)."""

    id: str
    name: str
    user: str
    priority: int
    started_at: int
    status: str = "open"
    ended_at: int = 0
    why: str = ""
    notes: int = 0
    runs: dict[str, str] = {}

    def count(self, status: str) -> int:
        return sum(found == status for found in self.runs.values())


def list_experiment_histories(log: Log) -> dict[str, ExperimentHistory]:
    """Every experiment of the log, in order of its start."""
    histories: dict[str, ExperimentHistory] = {}
    home: dict[str, str] = {}
    for event, head in decode_events(log.select(LogQuery(types=TYPES))):
        match event:
            case ExperimentStarted():
                histories[event.experiment] = make_from(
                    ExperimentHistory, event, id=event.experiment, started_at=head.recorded_at
                )
            case ExperimentCancelled() | ExperimentClosing():
                story = histories[event.experiment]
                story.status, story.why = event.TYPE.partition(".")[2], event.why
            case ExperimentEnded():
                story = histories[event.experiment]
                story.status, story.ended_at = "ended", head.recorded_at
                story.why = story.why or event.why
            case StartsPaused() if event.target in histories:
                story = histories[event.target]
                if story.status == "open":
                    story.status, story.why = "paused", event.why
            case StartsResumed() if event.target in histories:
                story = histories[event.target]
                if story.status == "paused":
                    story.status, story.why = "open", ""
            case ExperimentNoted():
                histories[event.experiment].notes += 1
            case RunSubmitted() if event.experiment in histories:
                home[event.run] = event.experiment
                histories[event.experiment].runs[event.run] = "alive"
            case RunCompleted() | RunFailed() | RunCancelled() if event.run in home:
                histories[home[event.run]].runs[event.run] = event.TYPE.partition(".")[2]
    return histories
