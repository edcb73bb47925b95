"""Traces of runs: one trace for each run, made from committed events. A trace has these spans, each inside
the previous one:

- ``run WORKFLOW``: from the submission of a run to its end; in it ``wait for start``,
- ``step KEY``: from a step's first request to its end, retries included,
- ``MODULE.ACTION``: one attempt at an action, from its request to the record of its end,
- ``commit request``, ``send``, ``device``, ``report`` and ``commit result``: the parts of its time. ``send``
and ``report`` are the bus and the node's journal. ``device`` ends at the time by the node's clock, if this is
within the action. An action outside of runs has its own trace. Ids are derived from the lab's id and the
names in the log, so that a run's trace can be found by the run's name.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import msgspec

from labos.core import runs as r
from labos.core.actions import (
    ActionAccepted,
    ActionEvent,
    ActionFailed,
    ActionReconciled,
    ActionRejected,
    ActionReported,
    ActionRequested,
    ActionSucceeded,
    ActionUnknown,
)
from labos.core.ids import ActionId, RunId, local
from labos.core.registry import list_handlers
from labos.core.state import LabState

if TYPE_CHECKING:
    from labos.runtime.ledger import Entry

Attribute = str | int | float | bool


class Span(msgspec.Struct, frozen=True):
    """A period of time in a trace. ``start`` and ``end`` are in UTC ns; ``parent`` is 0 at the top. ``error``
    is the reason of a failure; empty if there was none."""

    trace: int
    id: int
    parent: int
    name: str
    start: int
    end: int
    attributes: dict[str, Attribute]
    error: str = ""


Key = tuple[object, ...]
"""What names a span within its lab; empty for none."""


class _OpenRun(msgspec.Struct):
    """A run that has not ended, with the keys of its plan's steps and the started steps."""

    workflow: str
    attributes: dict[str, Attribute]
    submitted_at: int
    keys: tuple[str, ...] = ()
    steps: dict[int, _OpenStep] = {}


class _OpenStep(msgspec.Struct):
    """The first request of a step and the end of its last action (UTC ns), with the error of that action."""

    start: int
    end: int = 0
    error: str = ""


class _OpenAction(msgspec.Struct):
    """One attempt at an action; 0 stands for a time that is not known yet."""

    run: RunId
    step: int
    name: str
    attributes: dict[str, Attribute]
    requested_at: int
    durable_at: int = 0
    accepted_at: int = 0
    device_ended_at: int = 0


class SpanRecorder:
    """A kernel's listener that passes each span to ``emit`` when it has ended. ``now`` gives UTC ns."""

    def __init__(
        self, state: Callable[[], LabState], now: Callable[[], int], emit: Callable[[Span], None]
    ) -> None:
        self._state, self._now, self._emit = state, now, emit
        self._lab = ""
        self._runs: dict[RunId, _OpenRun] = {}
        self._actions: dict[ActionId, _OpenAction] = {}
        self._handlers = list_handlers(vars(SpanRecorder), None, "_on_")
        self._durable_at = 0
        """When the events were committed that are handled now."""

    # -- called by the kernel ------------------------------------------------------------------

    def on_committed(self, entries: Sequence[Entry]) -> None:
        self._durable_at = self._now()
        for entry in entries:
            handler = self._handlers.get(type(entry.event))
            if handler is not None:
                handler(self, entry.event, entry.record.head.recorded_at)

    def on_reopened(self) -> None:
        self.begin_with(self._state())

    def begin_with(self, state: LabState) -> None:
        """Take the work in progress from a state, before later events arrive."""
        self._lab = state.lab.id
        self._runs.clear()
        self._actions.clear()
        for run in (*state.runs.active.values(), *state.runs.queued.values()):
            known = self._runs[run.id] = _OpenRun(run.workflow, _attributes_of(run), run.submitted_at)
            if run.has_started:
                known.keys = self._list_keys(run.id)
        for action in state.actions.open.values():
            attributes = _action_attributes(action.id, action.module, action.name, action.attempt)
            self._actions[action.id] = _OpenAction(
                action.run, action.step, _name(action.module, action.name), attributes, action.requested_at
            )
            self._begin_step(action.run, action.step, action.requested_at)

    # -- runs ----------------------------------------------------------------------------------

    def _on_submitted(self, event: r.RunSubmitted, at: int) -> None:
        self._lab = self._lab or self._state().lab.id
        self._runs[event.run] = _OpenRun(event.workflow, _attributes_of(event), at)

    def _on_started(self, event: r.RunStarted, at: int) -> None:
        run = self._runs.get(event.run)
        if run is not None:
            run.keys = self._list_keys(event.run)
            key, parent = ("wait", event.run), ("run", event.run)
            self._emit_span(event.run, key, parent, "wait for start", run.submitted_at, at)

    def _on_run_ended(self, event: r.RunEnd, at: int) -> None:
        run = self._runs.pop(event.run, None)
        if run is None:
            return
        for number, step in run.steps.items():
            self._end_step(event.run, run, number, step)
        outcome = event.TYPE.rpartition(".")[2]
        error = event.why or outcome if isinstance(event, r.RunFailed | r.RunCancelled) else ""
        attributes = {**run.attributes, "labos.outcome": outcome}
        key, name = ("run", event.run), f"run {run.workflow}"
        self._emit_span(event.run, key, (), name, run.submitted_at, at, attributes, error)

    def _list_keys(self, name: RunId) -> tuple[str, ...]:
        """The keys of a run's steps; none if the run has already ended."""
        runs = self._state().runs
        run = runs.get(name)
        return tuple(step.key for step in runs.plan_of(run).steps) if run is not None else ()

    # -- steps ---------------------------------------------------------------------------------

    def _begin_step(self, name: RunId, number: int, at: int) -> None:
        run = self._runs.get(name)
        if run is not None and number not in run.steps:
            run.steps[number] = _OpenStep(at)

    def _end_step(self, name: RunId, run: _OpenRun, number: int, step: _OpenStep) -> None:
        key = run.keys[number] if number < len(run.keys) else str(number + 1)
        attributes: dict[str, Attribute] = {"labos.run": name, "labos.step": key}
        own, parent, end = ("step", name, number), ("run", name), step.end or step.start
        self._emit_span(name, own, parent, f"step {key}", step.start, end, attributes, step.error)

    # -- actions -------------------------------------------------------------------------------

    def _on_requested(self, event: ActionRequested, at: int) -> None:
        attributes = _action_attributes(event.action, event.module, event.name, event.attempt)
        name = _name(event.module, event.name)
        self._actions[event.action] = _OpenAction(
            event.run, event.step, name, attributes, at, self._durable_at
        )
        self._begin_step(event.run, event.step, at)

    def _on_accepted(self, event: ActionAccepted, at: int) -> None:
        action = self._actions.get(event.action)
        if action is not None:
            action.accepted_at = at

    def _on_reported(self, event: ActionReported, at: int) -> None:
        action = self._actions.get(event.action)
        if action is not None:
            action.device_ended_at = event.ended_ns

    def _on_ended(
        self, event: ActionSucceeded | ActionFailed | ActionRejected | ActionUnknown, at: int
    ) -> None:
        action = self._actions.pop(event.action, None)
        if action is None:
            return
        error = _error_of(event)
        action.device_ended_at = getattr(event, "ended_ns", 0) or action.device_ended_at
        attributes = {**action.attributes, "labos.outcome": event.TYPE.rpartition(".")[2]}
        attempt = ("attempt", event.action, action.attributes["labos.attempt"])
        trace = action.run or event.action
        parent = ("step", action.run, action.step) if action.run else ()
        end = max(at, self._durable_at)
        self._emit_span(trace, attempt, parent, action.name, action.requested_at, end, attributes, error)
        self._emit_parts(trace, attempt, action, at, end)
        run = self._runs.get(action.run)
        step = run.steps.get(action.step) if run is not None else None
        if run is not None and step is not None:
            step.end, step.error = at, error
            if not error:
                self._end_step(action.run, run, action.step, run.steps.pop(action.step))

    def _on_reconciled(self, event: ActionReconciled, at: int) -> None:
        """End the step here. The span of its action ended when the outcome became unknown."""
        run = self._runs.get(event.run)
        step = run.steps.get(event.step) if run is not None else None
        if step is not None:
            step.end = at
            step.error = "" if event.effects == "all" else f"settled as {event.effects} by {event.by}"

    def _emit_parts(self, trace: str, attempt: Key, action: _OpenAction, at: int, end: int) -> None:
        """Emit the parts of the time of an action. Unknown parts are left out."""

        def part(name: str, start: int, until: int) -> None:
            if until > start:
                self._emit_span(trace, (*attempt, name), attempt, name, start, until)

        sent = action.durable_at  # unknown for an action that an earlier kernel has sent
        began = action.accepted_at or sent
        ended = action.device_ended_at if began <= action.device_ended_at <= at else 0
        if sent:
            part("commit request", action.requested_at, sent)
            if action.accepted_at:
                part("send", sent, began)
            if ended:
                part("device", began, ended)
        if ended:
            part("report", max(ended, action.requested_at), at)
        part("commit result", at, end)

    # -- ids -----------------------------------------------------------------------------------

    def _emit_span(
        self,
        trace: str,
        key: Key,
        parent: Key,
        name: str,
        start: int,
        end: int,
        attributes: dict[str, Attribute] | None = None,
        error: str = "",
    ) -> None:
        """Emit a span of the ``trace`` of a run (or of an action outside of runs)."""
        ids = make_trace_id(self._lab, trace), self._make_id(key), self._make_id(parent)
        self._emit(Span(*ids, name, start, max(start, end), attributes or {}, error))

    def _make_id(self, key: Key) -> int:
        text = "/".join((self._lab, *map(str, key)))
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8]) if key else 0


def make_trace_id(lab: str, name: str) -> int:
    """The trace of a run (or of an action outside of runs) of the lab with this id."""
    return int.from_bytes(hashlib.sha256(f"{lab}/{name}".encode()).digest()[:16])


def _attributes_of(run: r.RunSubmitted | r.RunState) -> dict[str, Attribute]:
    name = run.run if isinstance(run, r.RunSubmitted) else run.id
    found = {"labos.run": name, "labos.workflow": run.workflow, "labos.user": run.user}
    found |= {"labos.experiment": run.experiment, "labos.campaign": run.campaign}
    return {key: str(value) for key, value in found.items() if value}


def _action_attributes(action: ActionId, module: str, name: str, attempt: int) -> dict[str, Attribute]:
    return {
        "labos.action_id": str(action),
        "labos.module": str(module),
        "labos.action": name,
        "labos.attempt": attempt,
    }


def _name(module: str, action: str) -> str:
    return f"{local(module)}.{action}"


def _error_of(event: ActionEvent) -> str:
    match event:
        case ActionFailed():
            return event.error
        case ActionRejected() | ActionUnknown():
            return event.why
    return ""
