"""Where the time was lost: while a lab has work, every minute counts as work or is charged to a cause.

The definition is in ``docs/time-without-human-intervention.md``. The time of a scope is divided at every
event; each part is charged to the scope as a whole, once.
"""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

from labos.core.envelope import Envelope, Record
from labos.core.lab import KernelStarted
from labos.core.registry import Event
from labos.core.rules import convert_lab_s
from labos.core.runs import RunState
from labos.services.log import decode_events
from labos.services.next_touch import Touch, list_next_touches
from labos.services.standstill import Cause, Standstill
from labos.services.twh import Meter, ScopeKind, TwhReport
from labos.services.waits import QUEUED_JUDGED

NO_KERNEL = Cause("error", "no kernel", "", "software")
"""LabOS itself did not run: from the last event before its end to the next start of a kernel."""

ABOUT_TO_START = Cause("other", "about to start")
"""There are runs, none has begun, and nothing prevents it."""

BRIEF_S = 0.1
"""For pauses between events that are shorter (lab seconds: a turn of the kernel and its commit), the whole
bench is not examined."""


class Loss(msgspec.Struct, frozen=True):
    """Time lost to one cause. ``on_clock_ns`` is the part of it in which the clock ran, because no person was
    asked."""

    cause: Cause
    lost_ns: int
    on_clock_ns: int = 0


class Interval(msgspec.Struct, frozen=True):
    """A run, or the lab (empty name), made no progress from one moment to another (UTC ns)."""

    run: str
    since: int
    until: int
    cause: Cause


class LossAccount(msgspec.Struct):
    """``span_ns = at_work_ns + the sum of what was lost``; ``clock_ns = at_work_ns`` + the losses while the
    clock ran. The largest losses are first."""

    kind: ScopeKind
    name: str
    span_ns: int
    at_work_ns: int
    clock_ns: int
    losses: tuple[Loss, ...]

    @property
    def lost_ns(self) -> int:
        return sum(loss.lost_ns for loss in self.losses)

    @property
    def for_a_person_ns(self) -> int:
        """The losses in which the lab waited for a person."""
        return sum(loss.lost_ns for loss in self.losses if waits_for_a_person(loss.cause))


class Losses(msgspec.Struct):
    """The account of each scope, beside its time without intervention. ``intervals`` are the times in which
    runs, and the lab, made no progress; ``next_touches`` are the next tasks for a person. ``end`` in UTC
    ns."""

    twh: TwhReport
    lab: LossAccount
    workcells: dict[str, LossAccount]
    experiments: dict[str, LossAccount]
    runs: dict[str, LossAccount]
    intervals: tuple[Interval, ...]
    next_touches: tuple[Touch, ...]
    end: int


def waits_for_a_person(cause: Cause) -> bool:
    """Whether the wait ends only when a person acts."""
    return cause.asked or cause.kind in ("person", "resource", "planned") or cause.what == "in error"


class _Book:
    """The account of one scope."""

    def __init__(self, kind: ScopeKind, name: str) -> None:
        self.kind: ScopeKind = kind
        self.name = name
        self.at_work_ns = 0
        self.lost: dict[Cause, list[int]] = {}

    def charge(self, cause: Cause | None, length: int, on_clock: bool) -> None:
        if cause is None:
            self.at_work_ns += length
            return
        entry = self.lost.setdefault(cause, [0, 0])
        entry[0] += length
        entry[1] += length if on_clock else 0

    def make_account(self) -> LossAccount:
        losses = sorted((Loss(cause, *ns) for cause, ns in self.lost.items()), key=lambda loss: -loss.lost_ns)
        lost, silent = sum(loss.lost_ns for loss in losses), sum(loss.on_clock_ns for loss in losses)
        span = self.at_work_ns + lost
        return LossAccount(
            self.kind, self.name, span, self.at_work_ns, self.at_work_ns + silent, tuple(losses)
        )


class LossBook:
    """Updates the accounts with each event."""

    def __init__(self) -> None:
        self.meter = Meter()
        self.standstill = Standstill()
        self.intervals: list[Interval] = []
        self._books: dict[tuple[ScopeKind, str], _Book] = {}
        self._since: dict[str, int] = {}
        self._open: dict[str, tuple[int, Cause]] = {}
        self._at = 0

    def add(self, event: Event, head: Envelope) -> None:
        """Take in one event, in order."""
        self._charge_until(head.recorded_at, NO_KERNEL if isinstance(event, KernelStarted) else None)
        self.meter.add(event, head)
        self.standstill.add(event, head)

    def report(self, now: int | None = None) -> Losses:
        """The accounts at ``now`` (UTC ns), by default at the time of the last event."""
        self._charge_until(max(now or 0, self._at), None)
        for name in list(self._open):
            self._note(name, None)
        found = {key: book.make_account() for key, book in self._books.items()}

        def list_accounts(kind: ScopeKind) -> dict[str, LossAccount]:
            return {name: account for (known, name), account in found.items() if known == kind}

        lab = found.get(("lab", ""), _Book("lab", "").make_account())
        return Losses(
            self.meter.report(self._at),
            lab,
            list_accounts("workcell"),
            list_accounts("experiment"),
            list_accounts("run"),
            tuple(self.intervals),
            tuple(list_next_touches(self.standstill.state, self._at)),
            self._at,
        )

    # -- internal ------------------------------------------------------------------------------

    def _charge_until(self, now: int, overall: Cause | None) -> None:
        """Charge the time since the last event, in which nothing changed."""
        length = now - self._at
        if length <= 0:
            return
        runs = self.standstill.state.runs
        if runs.active or runs.queued:
            self._charge(length, overall)
        for name in [name for name in self._open if name not in runs.active and name]:
            self._note(name, None)
        self._at = now

    def _charge(self, length: int, overall: Cause | None) -> None:
        state = self.standstill.state
        causes: dict[str, Cause | None] = {}
        briefly = length < convert_lab_s(state, BRIEF_S)
        for run in state.runs.active.values():
            cause = overall or self.standstill.find_cause(run, briefly=briefly)
            causes[run.id] = cause
            if cause is None:
                self._since.pop(run.id, None)
            else:
                self._since.setdefault(run.id, self._at)
            self._note(run.id, cause)
        for name in [name for name in self._since if name not in causes]:
            del self._since[name]
        for (kind, name), members in self._list_scopes(list(state.runs.active.values())).items():
            cause = self._find_common_cause(members, causes)
            on_clock = overall is None and any(map(self._on_clock, members))
            self._book(kind, name).charge(cause, length, on_clock)
            if kind == "lab":
                self._note("", cause)
        busy = {self._find_cell(run) for run in state.runs.active.values()}
        waiting: dict[tuple[ScopeKind, str], list[RunState]] = {}
        for run in state.runs.queued.values():
            if not busy:
                waiting.setdefault(("lab", ""), []).append(run)
            if self._find_cell(run) not in busy:
                waiting.setdefault(("workcell", self._find_cell(run)), []).append(run)
        for (kind, name), members in waiting.items():
            cause = overall or self._explain_not_begun(members, briefly)
            self._book(kind, name).charge(cause, length, False)
            if kind == "lab":
                self._note("", cause)

    def _find_common_cause(self, members: list[RunState], causes: dict[str, Cause | None]) -> Cause | None:
        """The cause for which several runs wait; None if one of them continues. If there are several causes,
        the one that began first."""
        found = [run for run in members if causes[run.id] is not None]
        if len(found) < len(members):
            return None
        return causes[min(found, key=lambda run: (self._since[run.id], run.position)).id]

    def _explain_not_begun(self, members: list[RunState], briefly: bool) -> Cause:
        """The reason why none of the waiting runs has started."""
        judged = members[:QUEUED_JUDGED]
        found = [self.standstill.find_cause(run, briefly=briefly) for run in judged]
        return ABOUT_TO_START if None in found or found[0] is None else found[0]

    def _list_scopes(self, runs: list[RunState]) -> dict[tuple[ScopeKind, str], list[RunState]]:
        """The runs in progress, by scope."""
        found: dict[tuple[ScopeKind, str], list[RunState]] = {}
        for run in runs:
            found.setdefault(("lab", ""), []).append(run)
            found.setdefault(("workcell", self._find_cell(run)), []).append(run)
            found.setdefault(("run", run.id), []).append(run)
            if run.experiment:
                found.setdefault(("experiment", run.experiment), []).append(run)
        return found

    def _on_clock(self, run: RunState) -> bool:
        state = self.standstill.state
        asked = any(question.run == run.id for question in state.interventions.open.values())
        return not (run.paused or asked or self._find_cell(run) in state.lab.access)

    def _note(self, name: str, cause: Cause | None) -> None:
        """Note when a run (empty: the lab) stopped making progress, and the cause."""
        known = self._open.get(name)
        if known is not None and known[1] != cause:
            self.intervals.append(Interval(name, known[0], self._at, known[1]))
            del self._open[name]
        if cause is not None:
            self._open.setdefault(name, (self._at, cause))

    def _find_cell(self, run: RunState) -> str:
        return self.standstill.state.runs.plan_of(run).workcell

    def _book(self, kind: ScopeKind, name: str) -> _Book:
        return self._books.setdefault((kind, name), _Book(kind, name))


def sum_losses(records: Iterable[Record], now: int | None = None) -> Losses:
    """The losses of every scope of a log. Raises LogTooNew, LogDamaged."""
    book = LossBook()
    for event, head in decode_events(records):
        book.add(event, head)
    return book.report(now)
