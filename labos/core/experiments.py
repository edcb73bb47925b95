"""What happens to an experiment, one execution of an application."""

from __future__ import annotations

from typing import Any

from labos.core.ids import ExperimentId, StationName
from labos.core.registry import Event, event
from labos.core.words import Words


class ExperimentEvent(Event, frozen=True):
    experiment: ExperimentId

    def stream(self) -> str:
        return self.experiment


@event("experiment.started")
class ExperimentStarted(ExperimentEvent, frozen=True):
    """An application has begun. ``closing`` is the plan that clears away what it parks between
    its runs (empty: none); ``parking`` are the stations where it parks (empty: anywhere)."""

    name: str
    user: str
    closing: str = ""
    priority: int = 0
    request: str = ""
    parking: tuple[StationName, ...] = ()


@event("experiment.cancelled")
class ExperimentCancelled(ExperimentEvent, frozen=True):
    """It takes no more runs, and closes when those that it has have ended."""

    why: Words


@event("experiment.closing")
class ExperimentClosing(ExperimentEvent, frozen=True):
    """The application is over; its closing workflow clears away its labware."""

    why: Words


@event("experiment.ended")
class ExperimentEnded(ExperimentEvent, frozen=True):
    """Nothing of it is left to do; ``closing`` is its closing plan, not needed any more. ``why`` is the
    reason of one that had nothing to clear away; of others ``experiment.closing`` has it."""

    closing: str = ""
    why: Words = ""


@event("experiment.resumed")
class ExperimentResumed(ExperimentEvent, frozen=True):
    """Its application was started again, and goes on where it was."""


@event("experiment.noted")
class ExperimentNoted(ExperimentEvent, frozen=True):
    """What an application logs of itself. ``kind``: loop_started, loop_ended,
    condition_checked, decision, local_compute, compute, flow, publication (the paper's logged
    events), or transfer. ``key`` names the call of the application that logged it, by which one that is
    started again finds it; an experiment has no two of one key."""

    kind: str
    name: str
    facts: dict[str, Any] = {}
    key: str = ""
