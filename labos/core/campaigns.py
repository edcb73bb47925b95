"""Experiments and the lab time their users have had."""

from __future__ import annotations

from typing import Literal

import msgspec

from labos.core.actions import (
    ActionFailed,
    ActionReconciled,
    ActionRejected,
    ActionRequested,
    ActionSucceeded,
)
from labos.core.experiments import ExperimentCancelled, ExperimentClosing, ExperimentEnded, ExperimentStarted
from labos.core.ids import ActionId, ExperimentId, RunId, StationName
from labos.core.runs import REQUESTS_KEPT, RunCancelled, RunCompleted, RunFailed, RunSubmitted

HALF_LIFE_NS = 24 * 3600 * 1_000_000_000
"""Lab time used counts half after a day."""


class Experiment(msgspec.Struct):
    id: ExperimentId
    name: str
    user: str
    closing: str
    priority: int
    started_at: int
    status: Literal["open", "cancelled", "closing"] = "open"
    runs: dict[RunId, bool] = {}
    parking: tuple[StationName, ...] = ()


class Usage(msgspec.Struct):
    """Module time in nanoseconds, decayed to ``at``."""

    used_ns: float = 0.0
    at: int = 0

    def level(self, now: int) -> float:
        return self.used_ns * float(0.5 ** ((now - self.at) / HALF_LIFE_NS))


class Campaigns(msgspec.Struct):
    """``experiments`` that have not ended; ``usage`` by user; ``users`` of runs alive;
    ``clocks`` hold when open actions were requested; ``named`` and ``requests`` as for runs. ``cancelled``
    are the experiments that close when their runs have ended, ``members`` the runs alive of experiments."""

    experiments: dict[ExperimentId, Experiment] = {}
    usage: dict[str, Usage] = {}
    users: dict[RunId, str] = {}
    clocks: dict[ActionId, int] = {}
    named: int = 0
    requests: dict[str, ExperimentId] = {}
    cancelled: dict[ExperimentId, bool] = {}
    members: dict[RunId, ExperimentId] = {}


def started(campaigns: Campaigns, event: ExperimentStarted, at: int) -> None:
    campaigns.named += 1
    if event.request:
        campaigns.requests[event.request] = event.experiment
        while len(campaigns.requests) > REQUESTS_KEPT:
            del campaigns.requests[next(iter(campaigns.requests))]
    campaigns.experiments[event.experiment] = Experiment(
        id=event.experiment,
        name=event.name,
        user=event.user,
        closing=event.closing,
        priority=event.priority,
        started_at=at,
        parking=event.parking,
    )


def cancelled(campaigns: Campaigns, event: ExperimentCancelled, at: int) -> None:
    campaigns.experiments[event.experiment].status = "cancelled"
    campaigns.cancelled[event.experiment] = True


def closing(campaigns: Campaigns, event: ExperimentClosing, at: int) -> None:
    campaigns.experiments[event.experiment].status = "closing"
    campaigns.cancelled.pop(event.experiment, None)


def ended(campaigns: Campaigns, event: ExperimentEnded, at: int) -> None:
    del campaigns.experiments[event.experiment]
    campaigns.cancelled.pop(event.experiment, None)


def submitted(campaigns: Campaigns, event: RunSubmitted, at: int) -> None:
    campaigns.users[event.run] = event.user
    experiment = campaigns.experiments.get(event.experiment)
    if experiment is not None:
        experiment.runs[event.run] = True
        campaigns.members[event.run] = event.experiment


def run_left(campaigns: Campaigns, event: RunCompleted | RunFailed | RunCancelled, at: int) -> None:
    campaigns.users.pop(event.run, None)
    member = campaigns.members.pop(event.run, None)
    experiment = campaigns.experiments.get(member) if member is not None else None
    if experiment is not None:
        experiment.runs.pop(event.run, None)


def clock_starts(campaigns: Campaigns, event: ActionRequested, at: int) -> None:
    campaigns.clocks.setdefault(event.action, at)


def clock_stops(
    campaigns: Campaigns, event: ActionRejected | ActionSucceeded | ActionFailed | ActionReconciled, at: int
) -> None:
    began = campaigns.clocks.pop(event.action, at)
    user = campaigns.users.get(event.run)
    if user is not None:
        usage = campaigns.usage.setdefault(user, Usage(at=at))
        usage.used_ns, usage.at = usage.level(at) + (at - began), at


HANDLERS = {
    ExperimentStarted: started,
    ExperimentCancelled: cancelled,
    ExperimentClosing: closing,
    ExperimentEnded: ended,
    RunSubmitted: submitted,
    RunCompleted: run_left,
    RunFailed: run_left,
    RunCancelled: run_left,
    ActionRequested: clock_starts,
    ActionRejected: clock_stops,
    ActionSucceeded: clock_stops,
    ActionFailed: clock_stops,
    ActionReconciled: clock_stops,
}
