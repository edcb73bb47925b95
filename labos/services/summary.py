"""Statistics of a lab: per run, per module, per user."""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

from labos.core import actions as a
from labos.core.envelope import Envelope, Record
from labos.core.registry import Event
from labos.core.structs import make_from
from labos.services.log import decode_events
from labos.services.runs import RunBook, RunHistory
from labos.services.twh import Meter, TwhReport
from labos.services.waits import WaitBook

EVENTS_EXPLAINED = 20_000
"""In longer logs the reasons of waits are left out, as each needs an examination of the whole bench."""


class WaitTime(msgspec.Struct, frozen=True):
    """The wall time that was spent on waiting for one cause."""

    why: str
    seconds: float


class RunSummary(msgspec.Struct, frozen=True):
    """Times in seconds. ``wall_s`` is from start to end (or now), ``queued_s`` before the start;
    ``working_s`` with an action in flight, ``waiting_s`` between steps."""

    id: str
    workflow: str
    user: str
    experiment: str
    status: str
    done: int
    steps: int
    queued_s: float
    wall_s: float
    lab_s: float
    working_s: float
    waiting_s: float
    step_s: tuple[float, ...]
    why: str = ""
    waits: tuple[WaitTime, ...] = ()


class ModuleSummary(msgspec.Struct, frozen=True):
    """``utilisation`` is the share of the lab's working time with an exclusive action in flight."""

    name: str
    actions: int
    failed: int
    unknown: int
    busy_s: float
    utilisation: float


class UserSummary(msgspec.Struct, frozen=True):
    """``module_s`` adds up the wall time of the user's actions, ``lab_s`` the same in lab time."""

    name: str
    runs: int
    completed: int
    actions: int
    module_s: float
    lab_s: float


class Summary(msgspec.Struct, frozen=True):
    """The statistics of a lab; ``wall_s`` is from the first run's start to the last event of a run."""

    lab: str
    pace: float
    events: int
    wall_s: float
    runs: tuple[RunSummary, ...]
    modules: tuple[ModuleSummary, ...]
    users: tuple[UserSummary, ...]
    twh: TwhReport


class _Use(msgspec.Struct):
    actions: int = 0
    failed: int = 0
    unknown: int = 0
    busy_ns: int = 0


class _Flight(msgspec.Struct, frozen=True):
    run: str
    module: str
    since: int
    exclusive: bool


class _Usage:
    """Counts which users and modules work while events are read."""

    def __init__(self) -> None:
        self.modules: dict[str, _Use] = {}
        self.runs: dict[str, _Use] = {}
        self.first = self.last = 0
        self._flying: dict[str, _Flight] = {}

    def add(self, event: Event, at: int) -> None:
        if not isinstance(event, a.ActionEvent) or isinstance(event, a.ActionEvidence):
            return
        self.first, self.last = self.first or at, at
        module = self.modules.setdefault(event.module, _Use())
        run = self.runs.setdefault(event.run, _Use())
        match event:
            case a.ActionRequested():
                flight = _Flight(event.run, event.module, at, event.exclusive)
                self._flying.setdefault(event.action, flight)
            case a.ActionUnknown():
                module.unknown += 1
            case a.ActionSucceeded():
                module.actions += 1
                run.actions += 1
            case a.ActionFailed():
                module.failed += 1
        if isinstance(event, a.ActionEnd):
            self._end_flight(event.action, at)

    def finish(self, now: int) -> None:
        """Count what is still in flight up to ``now``."""
        self.last = max(self.last, now) if self._flying else self.last
        for action in list(self._flying):
            self._end_flight(action, now)

    def _end_flight(self, action: str, at: int) -> None:
        flight = self._flying.pop(action, None)
        if flight is not None:
            if flight.exclusive:
                self.modules.setdefault(flight.module, _Use()).busy_ns += at - flight.since
            self.runs.setdefault(flight.run, _Use()).busy_ns += at - flight.since


def summarise(records: Iterable[Record], now: int | None = None) -> Summary:
    """The statistics of a log at ``now`` (UTC ns; by default at its last event). The causes of waits are
    computed unless the log is long. Raises LogTooNew, LogDamaged."""
    meter = Meter()
    book = RunBook(meter.names)
    usage = _Usage()
    waits: WaitBook | None = WaitBook()
    last: Envelope | None = None
    for event, head in decode_events(records):
        meter.add(event, head)
        book.add(event, head)
        usage.add(event, head.recorded_at)
        if waits is not None:
            waits.add(event, head)
            waits = waits if head.position <= EVENTS_EXPLAINED else None
        last = head
    end = max(now or 0, last.recorded_at if last else 0)
    usage.finish(end)
    if waits is not None and last is not None and end > last.recorded_at:
        waits.charge(end)
    names = meter.names
    span = max(usage.last - usage.first, 0)
    charged = waits.charged if waits is not None else {}
    return Summary(
        lab=names.lab,
        pace=names.pace,
        events=last.position if last else 0,
        wall_s=span / 1e9,
        runs=tuple(_run(run, end, names.pace, charged.get(run.id, {})) for run in book.runs.values()),
        modules=tuple(_summarise_module(name, use, span) for name, use in sorted(usage.modules.items())),
        users=_summarise_users(book, usage, names.pace),
        twh=meter.report(end),
    )


def _run(run: RunHistory, now: int, pace: float, waits: dict[str, int]) -> RunSummary:
    end = run.ended_at or now
    start = run.started_at or end
    flying = [(since, end) for since in run.flying.values()]
    working = measure_union_ns([*run.busy, *flying])
    return make_from(
        RunSummary,
        run,
        steps=run.in_play,
        queued_s=(start - run.submitted_at) / 1e9,
        wall_s=(end - start) / 1e9,
        lab_s=(end - start) / 1e9 * pace,
        working_s=working / 1e9,
        waiting_s=max(end - start - working, 0) / 1e9,
        step_s=tuple(
            ((step.ended_at or end) - step.requested_at) / 1e9 if step.requested_at else 0.0
            for step in run.steps
            if step.state != "asleep"
        ),
        waits=tuple(WaitTime(why, ns / 1e9) for why, ns in sorted(waits.items(), key=lambda item: -item[1])),
    )


def measure_union_ns(spans: list[tuple[int, int]]) -> int:
    """How long at least one of the spans was active."""
    total, reached = 0, 0
    for since, until in sorted(spans):
        total += max(until - max(since, reached), 0)
        reached = max(reached, until)
    return total


def _summarise_module(name: str, use: _Use, span: int) -> ModuleSummary:
    share = use.busy_ns / span if span else 0.0
    return ModuleSummary(name, use.actions, use.failed, use.unknown, use.busy_ns / 1e9, share)


def _summarise_users(book: RunBook, usage: _Usage, pace: float) -> tuple[UserSummary, ...]:
    found: list[UserSummary] = []
    for name in sorted({run.user for run in book.runs.values()}):
        runs = [run for run in book.runs.values() if run.user == name]
        used = [usage.runs[run.id] for run in runs if run.id in usage.runs]
        seconds = sum(use.busy_ns for use in used) / 1e9
        completed = sum(run.status == "completed" for run in runs)
        actions = sum(use.actions for use in used)
        found.append(UserSummary(name, len(runs), completed, actions, seconds, seconds * pace))
    return tuple(found)
