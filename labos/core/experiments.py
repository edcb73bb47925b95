"""The events of an experiment, one execution of an application."""

from __future__ import annotations

from typing import Any

from labos.core.ids import ExperimentId, StationName
from labos.core.registry import Event, event
from labos.core.words import Words


class ExperimentEvent(Event, frozen=True):
    STREAM = "experiment"
    experiment: ExperimentId


@event("experiment.started")
class ExperimentStarted(ExperimentEvent, frozen=True):
    """An application has started. ``closing`` is the plan that clears away the labware that it parks between
    its runs (empty: none). ``parking`` lists the stations where it may park labware (empty: anywhere)."""

    name: str
    user: str
    closing: str = ""
    priority: int = 0
    request: str = ""
    parking: tuple[StationName, ...] = ()


@event("experiment.cancelled")
class ExperimentCancelled(ExperimentEvent, frozen=True):
    """The experiment accepts no more runs. It closes when all its runs have ended."""

    why: Words


@event("experiment.closing")
class ExperimentClosing(ExperimentEvent, frozen=True):
    """The application has ended. Its closing workflow clears its labware away."""

    why: Words


@event("experiment.ended")
class ExperimentEnded(ExperimentEvent, frozen=True):
    """The experiment has ended. ``closing`` is its closing plan, which is no longer needed. ``why`` is the
    reason of an experiment that had nothing to clear away; otherwise ``experiment.closing`` has the
    reason."""

    closing: str = ""
    why: Words = ""


@event("experiment.resumed")
class ExperimentResumed(ExperimentEvent, frozen=True):
    """The experiment's application was started again and continues where it was."""


@event("experiment.noted")
class ExperimentNoted(ExperimentEvent, frozen=True):
    """An application logs a note. ``kind``: loop_started, loop_ended, condition_checked, decision,
    local_compute, compute, flow, publication (the paper's logged events), or transfer. ``key`` identifies the
    call in the application, so that a restarted application finds its result. A key occurs only once in an
    experiment."""

    kind: str
    name: str
    facts: dict[str, Any] = {}
    key: str = ""
