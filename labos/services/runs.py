"""The history of every run: its steps, when each was requested and ended, and the outcome."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import msgspec

from labos.core import actions as a
from labos.core import runs as r
from labos.core import steps as st
from labos.core.envelope import Envelope
from labos.core.model import MAIN, AnyPart
from labos.core.registry import Event
from labos.core.structs import make_from
from labos.errors import NotFound
from labos.ports import LogQuery
from labos.services.catalogue import Catalogue, read_catalogue, teach
from labos.services.log import Log, decode_events

FAMILIES = ("run", "action", "window")
OVER = ("completed", "failed", "cancelled")


class StepHistory(msgspec.Struct):
    """``state``: pending, in flight, done, failed, unknown, skipped, or asleep (a step for an emergency that
    has not occurred). Times in UTC ns, 0 if not yet."""

    index: int
    key: str
    module: str
    action: str
    state: str = "pending"
    attempts: int = 0
    requested_at: int = 0
    ended_at: int = 0
    error: str = ""
    result: Any = None
    breached: bool = False
    part: AnyPart = MAIN


class RunHistory(msgspec.Struct):
    """``status``: queued, active, paused, cancelling, leaving, completed, failed or cancelled. ``busy`` are
    the times (from, to) in which one of its actions was in flight. ``due_at`` is its due date (UTC ns, 0:
    none)."""

    id: str
    workflow: str
    workcell: str
    user: str
    experiment: str
    submitted_at: int
    steps: list[StepHistory] = []
    status: str = "queued"
    started_at: int = 0
    ended_at: int = 0
    why: str = ""
    paused: bool = False
    closing: bool = False
    campaign: str = ""
    busy: list[tuple[int, int]] = []
    flying: dict[str, int] = {}
    due_at: int = 0

    @property
    def over(self) -> bool:
        return self.status in OVER

    @property
    def in_play(self) -> int:
        """The number of its steps; steps for emergencies count only after the emergency has occurred."""
        return sum(step.state != "asleep" for step in self.steps)

    @property
    def done(self) -> int:
        return sum(step.state == "done" for step in self.steps)


class RunBook:
    """Folds events into the histories of runs."""

    def __init__(self, names: Catalogue) -> None:
        self.names = names
        self.runs: dict[str, RunHistory] = {}

    def add(self, event: Event, head: Envelope) -> None:
        """Take in one event; the catalogue must have taken it in before."""
        if isinstance(event, r.RunSubmitted):
            self._on_submitted(event, head.recorded_at)
        elif isinstance(event, a.ActionEvent):
            run = self.runs.get(event.run)
            if run is not None and event.step < len(run.steps):
                _fold_step(run, run.steps[event.step], event, head.recorded_at)
        elif isinstance(event, r.RunEvent):
            run = self.runs.get(event.run)
            if run is not None:
                _run(run, event, head.recorded_at)

    def _on_submitted(self, event: r.RunSubmitted, at: int) -> None:
        plan = self.names.plan_of(event.run) or self.names.plans.get(event.plan)
        self.runs[event.run] = make_from(
            RunHistory,
            event,
            id=event.run,
            workcell=plan.workcell if plan else "",
            submitted_at=at,
            steps=[
                StepHistory(
                    index,
                    step.key,
                    step.module,
                    step.action,
                    "pending" if step.part == MAIN else "asleep",
                    part=step.part,
                )
                for index, step in enumerate(plan.steps if plan else ())
            ],
        )


def run_histories(log: Log) -> dict[str, RunHistory]:
    """Every run of the log, in order of submission."""
    book = RunBook(read_catalogue(log))
    _add_events(book, decode_events(log.select(LogQuery(types=FAMILIES))))
    return book.runs


def run_history(log: Log, run: str) -> RunHistory:
    """One run, read only from its own stream and the stream with its plan, so that the length of the log does
    not matter. Raises NotFound."""
    own = list(decode_events(log.select(LogQuery(streams=(run,)))))
    names = Catalogue()
    teach(names, own)
    submitted = names.runs.get(run)
    if submitted is None:
        raise NotFound(f"There is no run {run!r} in this log.", remedy="List them: labos runs --all")
    if submitted.plan not in names.plans and submitted.planned_by:
        query = LogQuery(streams=(submitted.planned_by,), types=("plan",))
        teach(names, decode_events(log.select(query)))
    if submitted.plan not in names.plans:
        # For runs that were submitted before `planned_by` was recorded.
        names = read_catalogue(log)
    book = RunBook(names)
    _add_events(book, own)
    return book.runs[run]


def _add_events(book: RunBook, pairs: Iterable[tuple[Event, Envelope]]) -> None:
    for event, head in pairs:
        book.add(event, head)


def _run(run: RunHistory, event: r.RunEvent, at: int) -> None:
    match event:
        case r.RunBound():
            for step in run.steps:
                step.module = event.modules.get(step.key, step.module)
        case r.RunStarted():
            run.status, run.started_at = "active", at
        case r.RunPaused() | r.RunResumed():
            run.paused = isinstance(event, r.RunPaused)
            waiting = "active" if run.started_at else "queued"
            run.status = "paused" if run.paused else waiting
            run.why = event.why if isinstance(event, r.RunPaused) else ""
        case r.RunCancelling():
            run.status, run.why = "cancelling", run.why or event.why or event.reason
        case r.RunLeaving():
            run.status, run.paused = "leaving", False
            for step in run.steps:
                if step.index in event.steps:
                    step.state = "pending"
                elif step.state == "pending":
                    step.state = "skipped"
        case r.RunCompleted():
            _end_run(run, "completed", at)
        case r.RunFailed():
            run.why = f"{event.why} ({event.kind} error)"
            _end_run(run, "failed", at)
        case r.RunCancelled():
            run.why = run.why or event.why
            _end_run(run, "cancelled", at)
        case st.WindowBreached():
            if event.step < len(run.steps):
                run.steps[event.step].breached = True
        case st.StepSkipped() | st.StepRecovering() | st.StepUnexpected():
            if event.step < len(run.steps):
                step = run.steps[event.step]
                step.state = "skipped" if isinstance(event, st.StepSkipped) else "failed"
                step.error = event.why
            for other in run.steps if isinstance(event, st.StepRecovering) else ():
                if other.part == event.step and other.state == "asleep":
                    other.state = "pending"
        case st.StepRetried():
            if event.step < len(run.steps):
                run.steps[event.step].state = "pending"


def _end_run(run: RunHistory, status: str, at: int) -> None:
    run.status, run.ended_at = status, at
    for begun in run.flying.values():
        run.busy.append((begun, at))
    run.flying.clear()


def describe_step_end(event: a.ActionEnd) -> tuple[str, str]:
    """The state of a step after the end of its action, and its error."""
    match event:
        case a.ActionSucceeded():
            return "done", ""
        case a.ActionFailed():
            return "failed", event.error
        case a.ActionRejected():
            return ("failed" if event.final else "pending"), event.why
        case a.ActionReconciled():
            state = {"all": "done", "none": "pending"}.get(event.effects, "failed")
            return state, "" if state == "done" else f"settled by {event.by}"


def _fold_step(run: RunHistory, step: StepHistory, event: a.ActionEvent, at: int) -> None:
    match event:
        case a.ActionRequested():
            step.state, step.attempts = "in flight", max(step.attempts, event.attempt)
            if event.action not in run.flying:
                step.requested_at = at
                step.ended_at, step.error = 0, ""
            run.flying.setdefault(event.action, at)
        case a.ActionAccepted() | a.ActionReported():
            step.state, step.error = "in flight", ""
        case a.ActionUnknown():
            step.state, step.error = "unknown", event.why
    if isinstance(event, a.ActionEnd):
        step.state, step.error = describe_step_end(event)
        step.ended_at = at
        if isinstance(event, a.ActionSucceeded):
            step.result = event.result
        begun = run.flying.pop(event.action, None)
        if begun is not None:
            run.busy.append((begun, at))
