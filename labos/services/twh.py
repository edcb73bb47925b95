"""Time without human intervention, computed from events alone.

The definition is in ``docs/time-without-human-intervention.md``; in short: in each scope (run,
experiment, workcell, lab) a clock runs while at least one of its runs has started, has not ended,
is not paused and does not wait for a person's answer. A person's intervention ends a stretch; a
planned touch (loading, refilling in time) is only counted.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from copy import copy
from typing import Literal

import msgspec

from labos.core import runs as r
from labos.core.actions import ActionSucceeded
from labos.core.envelope import Envelope, Record
from labos.core.experiments import ExperimentEnded
from labos.core.ids import workcell_of
from labos.core.interventions import InterventionRequested, InterventionResolved
from labos.core.lab import AccessEnded, AccessRequested, KernelStarted, WorkcellApplied
from labos.core.labware import (
    LabwarePlaced,
    LabwareRemoved,
    StationDeclared,
    StationLoaded,
    StationObserved,
    StationUnloaded,
    WasteEmptied,
)
from labos.core.modules import EmergencyStopped, ModulePutBack, ModuleTakenOut
from labos.core.registry import Event
from labos.core.resources import LevelSet, ResourceReplenished
from labos.core.structs import make_from
from labos.core.topics import Approval, PlannedWork
from labos.services.catalogue import LEARNT, Catalogue
from labos.services.log import decode_events

ScopeKind = Literal["lab", "workcell", "experiment", "run"]


HEARD = frozenset(
    kind.TYPE
    for kind in (
        ActionSucceeded,
        r.RunStarted,
        r.RunPaused,
        r.RunResumed,
        r.RunLeaving,
        r.RunCompleted,
        r.RunFailed,
        r.RunCancelled,
        ExperimentEnded,
        StationObserved,
        InterventionResolved,
        KernelStarted,
        WorkcellApplied,
        AccessRequested,
        AccessEnded,
        StationDeclared,
        StationLoaded,
        StationUnloaded,
        ResourceReplenished,
        WasteEmptied,
        LabwarePlaced,
        LabwareRemoved,
        LevelSet,
        ModuleTakenOut,
        ModulePutBack,
        EmergencyStopped,
    )
).union(LEARNT)
"""The types of events that change the figures; for all others only the time counts."""


class Stretch(msgspec.Struct):
    """Working time in ns without intervention, between two wall times; ``commands`` is the number of actions
    completed in it."""

    since: int = 0
    until: int = 0
    worked_ns: int = 0
    commands: int = 0


class Twh(msgspec.Struct):
    """The figures of one scope. ``current`` is the stretch that no intervention has ended yet; ``working``
    says whether its clock runs; ``planned`` is the number of planned touches; ``clock_ns`` is the time on the
    clock in all stretches together."""

    kind: ScopeKind
    name: str
    current: Stretch
    longest: Stretch
    interventions: int = 0
    working: bool = False
    planned: int = 0
    clock_ns: int = 0


class TwhReport(msgspec.Struct):
    """Every scope's figures; ``pace`` turns wall time into lab time."""

    lab: Twh
    workcells: dict[str, Twh]
    experiments: dict[str, Twh]
    runs: dict[str, Twh]
    pace: float = 1.0


class _Clock(Twh):
    """The figures of one scope up to ``at``; its clock runs because of the runs in ``running``."""

    current: Stretch = msgspec.field(default_factory=Stretch)
    longest: Stretch = msgspec.field(default_factory=Stretch)
    running: set[str] = set()
    at: int = 0

    def advance(self, now: int) -> None:
        if self.working and now > self.at:
            self.current.since = self.current.since or self.at
            self.current.worked_ns += now - self.at
            self.clock_ns += now - self.at
            self.current.until = now
        self.at = max(now, self.at)

    def set(self, run: str, works: bool, now: int) -> None:
        self.advance(now)
        (self.running.add if works else self.running.discard)(run)
        self.working = bool(self.running)

    def finish_command(self, now: int) -> None:
        self.advance(now)
        self.current.commands += 1

    def end_stretch(self, now: int) -> None:
        self.advance(now)
        self.interventions += 1
        self._compare()
        self.current = Stretch()

    def note_planned_help(self, now: int) -> None:
        """A person did planned work: no stretch ends."""
        self.advance(now)
        self.planned += 1

    def start_over(self, now: int) -> None:
        """Delete all earlier counts."""
        self.advance(now)
        self.current, self.longest = Stretch(), Stretch()
        self.interventions = self.planned = self.clock_ns = 0

    def _compare(self) -> None:
        if self.current.worked_ns > self.longest.worked_ns:
            self.longest = self.current

    def measure(self, now: int) -> Twh:
        self.advance(now)
        self._compare()
        return make_from(Twh, self, current=copy(self.current), longest=copy(self.longest))


class Meter:
    """Measures every scope while events are read. With ``keep``, only so many ended runs and experiments, and
    so many plans, are kept in memory: for a kernel that measures for months. ``causes`` counts the
    interventions that ended a stretch: by the kind of question, or by the type of a person's action."""

    def __init__(self, keep: int | None = None) -> None:
        self.names = Catalogue()
        self.causes: Counter[str] = Counter()
        self._keep = keep
        self._ended: deque[str] = deque()
        self._lab = _Clock("lab", "")
        self._cells: dict[str, _Clock] = {}
        self._experiments: dict[str, _Clock] = {}
        self._runs: dict[str, _Clock] = {}
        self._alive: set[str] = set()
        self._paused: set[str] = set()
        self._held: set[str] = set()
        self._asked: dict[str, str] = {}
        self._settings: set[str] = set()
        self._counted: set[str] = set()
        self._seen: set[str] = set()
        self._touches: set[str] = set()
        self._busy_cells: set[str] = set()
        self._now = 0

    def add(self, event: Event, head: Envelope) -> None:
        """Take in one event, in order."""
        at, before = head.recorded_at, self._now
        self._now = at
        self.names.learn(event)
        match event:
            case ActionSucceeded():
                for clock in self._list_clocks(event.run):
                    clock.finish_command(at)
            case r.RunSubmitted():
                self._on_request(event, head)
            case r.RunStarted():
                self._alive.add(event.run)
                self._set(event.run, at)
            case r.RunPaused() | r.RunResumed():
                (self._paused.add if isinstance(event, r.RunPaused) else self._paused.discard)(event.run)
                self._set(event.run, at)
            case r.RunLeaving():  # the cancellation ends a pause
                self._paused.discard(event.run)
                self._set(event.run, at)
            case r.RunCompleted() | r.RunFailed() | r.RunCancelled():
                self._alive.discard(event.run)
                self._set(event.run, at)
                self._forget_one(event.run)
            case ExperimentEnded():
                self._forget_one(event.experiment)
            case InterventionRequested():
                if event.run:
                    self._asked[event.intervention] = event.run
                    self._set(event.run, at)
            case StationObserved():
                if _is_person(head.actor):
                    self._seen.add(head.id)
            case InterventionResolved():
                self._on_answer(event, head)
            case KernelStarted():
                self._skip(before, at)
            case WorkcellApplied():
                self._settings.add(head.id)
            case AccessRequested() | AccessEnded():
                self._on_access(event, head)
            case StationDeclared():
                self._on_touch(workcell_of(event.station), head)
            case StationLoaded() | StationUnloaded() | ResourceReplenished():
                name = event.module if isinstance(event, ResourceReplenished) else event.station
                (self._on_touch if event.awaited else self._on_planned_help)(workcell_of(name), head)
            case WasteEmptied():
                self._on_planned_help(workcell_of(event.station), head)
            case LabwarePlaced() | LabwareRemoved() if not event.run and not event.action:
                place = event.station if isinstance(event, LabwarePlaced) else event.where
                if place:
                    self._on_planned_help(workcell_of(place), head)
            case ModuleTakenOut(failures=failures) if failures:
                pass  # a quarantine: no person did it
            case LevelSet() | ModuleTakenOut() | ModulePutBack() | EmergencyStopped():
                self._on_touch(workcell_of(event.module), head)

    def start_over(self, now: int) -> None:
        """Measure only from ``now`` (UTC ns) on, as for one shift; runs in progress are still counted as in
        progress."""
        for clock in self._list_all():
            clock.start_over(max(now, self._now))

    def report(self, now: int | None = None) -> TwhReport:
        """The figures at ``now`` (UTC ns), by default at the last event."""
        at = max(self._now, now or 0)
        return TwhReport(
            *self.read_totals(at),
            {name: clock.measure(at) for name, clock in self._experiments.items()},
            {name: clock.measure(at) for name, clock in self._runs.items()},
            self.names.pace,
        )

    def read_totals(self, now: int) -> tuple[Twh, dict[str, Twh]]:
        """The figures of the lab and of its workcells at ``now`` (UTC ns)."""
        at = max(self._now, now)
        return self._lab.measure(at), {name: clock.measure(at) for name, clock in self._cells.items()}

    def pass_time(self, now: int) -> None:
        """An event without a change of the figures was recorded at ``now`` (UTC ns): a kernel was running
        then."""
        self._now = now

    # -- internal ------------------------------------------------------------------------------

    def _forget_one(self, ended: str) -> None:
        """Store an ended run or experiment, and remove the oldest one."""
        if self._keep is None:
            return
        self._ended.append(ended)
        while len(self._ended) > self._keep:
            old = self._ended.popleft()
            for store in (self._runs, self._experiments, self.names.runs, self.names.experiments):
                store.pop(old, None)
        if len(self.names.plans) > 2 * self._keep:
            used = {run.plan for run in self.names.runs.values()}
            used.update(experiment.closing for experiment in self.names.experiments.values())
            for plan in [plan for plan in self.names.plans if plan not in used]:
                del self.names.plans[plan]

    def _list_clocks(self, run: str) -> list[_Clock]:
        """The clocks of the scopes that a run belongs to."""
        clocks = [self._lab]
        if run in self.names.runs:
            cell, experiment = self.names.find_workcell(run), self.names.find_experiment(run)
            clocks.append(self._cells.setdefault(cell, _Clock("workcell", cell)))
            clocks.append(self._runs.setdefault(run, _Clock("run", run)))
            if experiment:
                clocks.append(self._experiments.setdefault(experiment, _Clock("experiment", experiment)))
        return clocks

    def _set(self, run: str, at: int) -> None:
        works = run in self._alive and run not in self._paused and run not in self._asked.values()
        works = works and self.names.find_workcell(run) not in self._held
        for clock in self._list_clocks(run):
            clock.set(run, works, at)

    def _on_request(self, event: r.RunSubmitted, head: Envelope) -> None:
        """A request for work is not an intervention; an action that brings a module out of its error is
        one."""
        cell, plan = self.names.find_workcell(event.run), self.names.plan_of(event.run)
        if plan is not None and plan.steps and all(step.recovers for step in plan.steps):
            self._on_touch(cell, head)
        else:
            self._busy_cells.add(cell)

    def _on_answer(self, event: InterventionResolved, head: Envelope) -> None:
        question = self.names.interventions.get(event.intervention)
        run = self._asked.pop(event.intervention, "")
        planned = question is not None and question.kind == PlannedWork.KIND
        if planned and event.choice != "withdrawn":
            self._counted.add(head.id)
            for clock in self._list_clocks(run):
                clock.note_planned_help(head.recorded_at)
        elif question is not None and question.kind == Approval.KIND:
            self._counted.add(head.id)  # the start of work is not an intervention, like the request for it
        elif (event.choice != "withdrawn" and _is_person(event.by)) or head.causation in self._seen:
            self._counted.add(head.id)
            if run:
                clocks = self._list_clocks(run)
            elif question is not None and question.subject in self._experiments:
                clocks = [self._lab, self._experiments[question.subject]]
            else:
                clocks = self._list_all_of(workcell_of(question.module) if question else "")  # type: ignore[arg-type]
            self.causes[question.kind if question is not None else head.type] += 1
            for clock in clocks:
                clock.end_stretch(head.recorded_at)
        if run:
            self._set(run, head.recorded_at)

    def _on_access(self, event: AccessRequested | AccessEnded, head: Envelope) -> None:
        """A person does planned work in a workcell: its clocks stand still, and no stretch ends."""
        cell = event.name
        (self._held.add if isinstance(event, AccessRequested) else self._held.discard)(cell)
        self._counted.add(head.id)
        runs = [run for run in sorted(self._alive) if self.names.find_workcell(run) == cell]
        for run in runs:
            self._set(run, head.recorded_at)
        if isinstance(event, AccessEnded) and cell in self._busy_cells:
            for clock in self._list_all_of(cell):
                clock.note_planned_help(head.recorded_at)

    def _on_touch(self, cell: str, head: Envelope) -> None:
        """A person acted on a workcell. Events that an answer or the set-up of the workcell caused are not
        counted again."""
        if head.causation in self._settings or head.causation in self._counted:
            return
        if cell not in self._busy_cells or cell in self._held or not _is_person(head.actor):
            return
        self._counted.add(head.id)
        self.causes[head.type] += 1
        for clock in self._list_all_of(cell):
            clock.end_stretch(head.recorded_at)

    def _on_planned_help(self, cell: str, head: Envelope) -> None:
        """A person loaded, unloaded or refilled something in time: the clock continues."""
        if cell in self._held or head.causation in self._settings or head.causation in self._counted:
            return
        if cell not in self._busy_cells or not _is_person(head.actor) or head.causation in self._touches:
            return
        self._touches.add(head.id)
        for clock in self._list_all_of(cell):
            clock.planned += 1

    def _list_all_of(self, cell: str) -> list[_Clock]:
        """The lab, the workcell (every one, if none is named), and its experiments and runs that have not
        ended."""
        clocks: dict[int, _Clock] = {id(self._lab): self._lab}
        for name, clock in self._cells.items():
            if not cell or name == cell:
                clocks[id(clock)] = clock
        for run in sorted(self._alive):
            if not cell or self.names.find_workcell(run) == cell:
                clocks.update((id(clock), clock) for clock in self._list_clocks(run))
        return list(clocks.values())

    def _skip(self, before: int, at: int) -> None:
        """No kernel was running between the last event and this one: no clock ran."""
        for clock in self._list_all():
            clock.advance(before)
            clock.at = at

    def _list_all(self) -> tuple[_Clock, ...]:
        return (self._lab, *self._cells.values(), *self._experiments.values(), *self._runs.values())


def measure(records: Iterable[Record], now: int | None = None) -> TwhReport:
    """Time without human intervention in every scope of a log."""
    meter = Meter()
    for event, head in decode_events(records):
        meter.add(event, head)
    return meter.report(now)


def _is_person(actor: str) -> bool:
    """LabOS itself and modules (``workcell/module``) are not persons."""
    return actor not in ("", "labos") and "/" not in actor
