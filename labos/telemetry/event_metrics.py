"""Metrics of past events, counted when events are committed, with a few table look-ups for each."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import msgspec

from labos.core import fold
from labos.core import runs as r
from labos.core.actions import (
    ActionEnd,
    ActionFailed,
    ActionReconciled,
    ActionRequested,
    ActionSucceeded,
    ActionUnknown,
)
from labos.core.ids import ActionId, InterventionId, ModuleName, RunId, local, workcell_of
from labos.core.interventions import InterventionRequested, InterventionResolved
from labos.core.lab import WorkcellApplied
from labos.core.modules import NodeJoined
from labos.core.plans import PlanRecorded
from labos.core.registry import TYPES, list_handlers
from labos.core.resources import ResourceConsumed
from labos.core.state import LabState
from labos.telemetry.series import (
    ACTION_BOUNDS_S,
    BoundedNames,
    ComputedCounter,
    CounterMetric,
    Distribution,
    MetricGroup,
)

if TYPE_CHECKING:
    from labos.runtime.ledger import Entry

assert fold  # it registers the types of events

PLANS_KNOWN = 10_000
"""The number of plans whose workcell is stored."""

COMMIT_BOUNDS_S = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
TURN_BOUNDS_S = (0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.5)
RUN_BOUNDS_S = (5.0, 20.0, 60.0, 300.0, 900.0, 1800.0, 3600.0, 7200.0, 14400.0, 28800.0, 86400.0, 259200.0)
ANSWER_BOUNDS_S = (10.0, 60.0, 300.0, 900.0, 1800.0, 3600.0, 14400.0, 43200.0, 86400.0)


class _Open(msgspec.Struct):
    """An action under way."""

    name: str
    at: int
    run: str
    exclusive: bool


class _Alive(msgspec.Struct):
    """A run that has not ended: its labels, its user, and when it was submitted and started (UTC ns)."""

    workcell: str
    workflow: str
    user: str
    submitted_at: int
    started_at: int = 0


class _Busy(msgspec.Struct):
    """The number of actions that keep a module busy, the start of this, and the earlier busy time (ns)."""

    count: int = 0
    since: int = 0
    before: int = 0


class EventMetrics(MetricGroup):
    """A kernel's listener. ``begin_with`` gives it the work under way; ``state`` returns the state after the
    log was read again. ``workflows`` and ``users`` limit these labels."""

    def __init__(self, state: Callable[[], LabState], workflows: BoundedNames, users: BoundedNames) -> None:
        self._state, self._workflow, self._user = state, workflows, users
        cell, module = ("workcell",), ("workcell", "module")
        self.events = CounterMetric("labos_events_total", "Committed events, by type.", ("type",), most=200)
        self.reopened_log = CounterMetric(
            "labos_log_reopened_total",
            "The number of times that the log was read again after a failed commit.",
        )
        self.commit_s = Distribution(
            "labos_commit_duration_seconds",
            "Time that the database took to commit a batch of events.",
            bounds=COMMIT_BOUNDS_S,
        )
        self.turn_s = Distribution(
            "labos_turn_duration_seconds",
            "Time that the kernel took to decide a command and to plan the steps that follow.",
            bounds=TURN_BOUNDS_S,
        )
        self.runs_ended = CounterMetric(
            "labos_runs_ended_total",
            "Runs that have ended; outcome is completed, failed or cancelled.",
            (*cell, "workflow", "outcome"),
        )
        self.run_failures = CounterMetric(
            "labos_run_failures_total",
            "Runs that have failed, by class of failure: software, operational or experiment.",
            (*cell, "failure"),
            most=500,
        )
        self.run_s = Distribution(
            "labos_run_duration_seconds",
            "Time from a run's first step to its end, if it was completed.",
            ("workflow",),
            bounds=RUN_BOUNDS_S,
            most=51,
        )
        self.run_wait_s = Distribution(
            "labos_run_wait_seconds", "Time from a run's submission to its first step.", cell, most=250
        )
        self.actions = CounterMetric(
            "labos_actions_total",
            "Actions that have ended, or whose outcome is unknown; outcome is succeeded, failed, rejected "
            "or unknown.",
            (*module, "action", "outcome"),
            most=12_000,
        )
        self.action_s = Distribution(
            "labos_action_duration_seconds",
            "Time from the request of an action to its end, by module.",
            (*module, "action"),
            most=4_000,
        )
        self.driver_s = Distribution(
            "labos_driver_action_duration_seconds",
            "Time from the request of an action to its end, by driver.",
            ("driver", "action"),
            bounds=ACTION_BOUNDS_S,
            most=250,
        )
        self.busy_s = ComputedCounter(
            "labos_module_busy_seconds_total",
            "Time for which actions kept the module busy; its rate is the utilisation.",
            module,
            most=2_000,
        )
        self.user_s = CounterMetric(
            "labos_user_module_seconds_total",
            "Module time that the actions of a user's runs have used.",
            ("user",),
            most=101,
        )
        self.consumed = CounterMetric(
            "labos_resource_consumed_total",
            "The amount of a resource that actions have used up, in its own unit.",
            (*module, "resource"),
        )
        self.asked = CounterMetric(
            "labos_interventions_requested_total", "Questions and tasks for a person.", ("kind",), most=40
        )
        self.answer_s = Distribution(
            "labos_intervention_duration_seconds",
            "Time from a question to its answer.",
            ("kind",),
            bounds=ANSWER_BOUNDS_S,
            most=40,
        )
        for name in TYPES:
            self.events.begin((name,))
        self._open: dict[ActionId, _Open] = {}
        self._runs: dict[RunId, _Alive] = {}
        self._cells: OrderedDict[str, str] = OrderedDict()
        self._drivers: dict[ModuleName, str] = {}
        self._busy: dict[ModuleName, _Busy] = {}
        self._questions: dict[InterventionId, tuple[str, int]] = {}
        self._handlers = list_handlers(vars(EventMetrics), None, "_on_")

    # -- called by the kernel ------------------------------------------------------------------

    def on_committed(self, entries: Sequence[Entry]) -> None:
        for entry in entries:
            event = entry.event
            self.events.add((event.TYPE,))
            handler = self._handlers.get(type(event))
            if handler is not None:
                handler(self, event, entry.record.head.recorded_at)

    def on_reopened(self) -> None:
        """Start again from the present state, because events of a commit in doubt were not reported."""
        self.reopened_log.add()
        self.begin_with(self._state())

    def begin_with(self, state: LabState) -> None:
        """Take the work under way from a state, before later events arrive."""
        self._drivers = {name: m.driver or m.spec.driver for name, m in state.modules.by_name.items()}
        self._cells = OrderedDict((name, known.plan.workcell) for name, known in state.runs.plans.items())
        self._runs.clear()
        for run in (*state.runs.active.values(), *state.runs.queued.values()):
            cell, workflow = state.runs.plan_of(run).workcell, self._workflow(run.workflow)
            self._runs[run.id] = _Alive(cell, workflow, run.user, run.submitted_at, run.started_at)
        self._open = {
            action.id: _Open(action.name, action.requested_at, action.run, action.exclusive)
            for action in state.actions.open.values()
        }
        before = {name: busy.before for name, busy in self._busy.items()}
        self._busy = {name: _Busy(before=before.get(name, 0)) for name in state.modules.by_name}
        for action in state.actions.open.values():
            self._take_up(action.module, action.requested_at, action.exclusive)
        self._questions = {q.id: (q.kind, q.requested_at) for q in state.interventions.open.values()}

    def update(self, now: int) -> None:
        """Add the busy time of work under way at ``now`` (UTC ns) to that of ended work."""
        self.busy_s.replace(
            {
                (workcell_of(name), local(name)): (
                    busy.before + (max(now - busy.since, 0) if busy.count else 0)
                )
                / 1e9
                for name, busy in self._busy.items()
            }
        )

    # -- modules and actions -------------------------------------------------------------------

    def _on_workcell(self, event: WorkcellApplied, at: int) -> None:
        names = {spec.name for spec in event.modules}
        for name in [name for name in self._busy if workcell_of(name) == event.name and name not in names]:
            del self._busy[name]
        for spec in event.modules:
            self._drivers.setdefault(spec.name, spec.driver)
            self._busy.setdefault(spec.name, _Busy())
        self.run_wait_s.begin((event.name,))

    def _on_joined(self, event: NodeJoined, at: int) -> None:
        self._drivers[event.module] = event.driver

    def _take_up(self, module: ModuleName, at: int, exclusive: bool) -> None:
        if exclusive:
            busy = self._busy.setdefault(module, _Busy())
            busy.since = busy.since if busy.count else at
            busy.count += 1

    def _on_requested(self, event: ActionRequested, at: int) -> None:
        if event.action not in self._open:  # else it is sent once more
            self._open[event.action] = _Open(event.name, at, event.run, event.exclusive)
            self._take_up(event.module, at, event.exclusive)

    def _on_ended(self, event: ActionEnd, at: int) -> None:
        known = self._open.pop(event.action, None)
        if known is None:
            return
        if known.exclusive and event.module in self._busy:
            busy = self._busy[event.module]
            busy.count -= 1
            if not busy.count:
                busy.before += max(at - busy.since, 0)
        seconds = (at - known.at) / 1e9
        place = (workcell_of(event.module), local(event.module), known.name)
        run = self._runs.get(RunId(known.run))
        if run is not None:
            self.user_s.add((self._user(run.user),), seconds)
        if not isinstance(event, ActionReconciled):  # counted when the outcome became unknown
            outcome = event.TYPE.rpartition(".")[2]
            self.actions.add((*place, outcome))
        if isinstance(event, ActionSucceeded | ActionFailed):
            self.action_s.observe(seconds, place)
            self.driver_s.observe(seconds, (self._drivers.get(event.module, ""), known.name))

    def _on_unknown(self, event: ActionUnknown, at: int) -> None:
        known = self._open.get(event.action)
        if known is not None:
            self.actions.add((workcell_of(event.module), local(event.module), known.name, "unknown"))

    def _on_consumed(self, event: ResourceConsumed, at: int) -> None:
        self.consumed.add((workcell_of(event.module), local(event.module), event.resource), event.amount)

    # -- runs ----------------------------------------------------------------------------------

    def _on_plan(self, event: PlanRecorded, at: int) -> None:
        self._cells[event.plan] = event.workcell
        if len(self._cells) > PLANS_KNOWN:
            self._cells.popitem(last=False)

    def _on_submitted(self, event: r.RunSubmitted, at: int) -> None:
        cell = self._cells.get(event.plan, "")
        if cell:
            self._cells.move_to_end(event.plan)
        self._runs[event.run] = _Alive(cell, self._workflow(event.workflow), event.user, at)
        self.user_s.begin((self._user(event.user),))

    def _on_started(self, event: r.RunStarted, at: int) -> None:
        run = self._runs.get(event.run)
        if run is not None:
            run.started_at = at
            self.run_wait_s.observe((at - run.submitted_at) / 1e9, (run.workcell,))

    def _on_run_ended(self, event: r.RunEnd, at: int) -> None:
        run = self._runs.pop(event.run, None)
        if run is None:
            return
        self.runs_ended.add((run.workcell, run.workflow, event.TYPE.rpartition(".")[2]))
        if isinstance(event, r.RunFailed):
            self.run_failures.add((run.workcell, event.kind))
        elif isinstance(event, r.RunCompleted):
            self.run_s.observe((at - run.started_at) / 1e9, (run.workflow,))

    # -- people --------------------------------------------------------------------------------

    def _on_asked(self, event: InterventionRequested, at: int) -> None:
        self._questions[event.intervention] = (event.kind, at)
        self.asked.add((event.kind,))

    def _on_answered(self, event: InterventionResolved, at: int) -> None:
        known = self._questions.pop(event.intervention, None)
        if known is not None:
            self.answer_s.observe((at - known[1]) / 1e9, (known[0],))
