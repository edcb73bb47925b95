"""The kernel: the one process that decides and writes.

A *turn* takes one command: its events, and the reactions to them, are decided and folded one after the other.
Planning proposes starts, and each of them is carried out in the same way. All events of the turn are one
batch for the writer. Replies and requests to nodes wait until the batch is on disk.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence

import msgspec
import structlog

from labos.clock import Clock, Ids, new_salt
from labos.core.actions import ActionAccepted
from labos.core.decide import LABOS, Command, Denied, Rejection, carry_out
from labos.core.decide.access import GrantAccess
from labos.core.decide.lab import CreateLab, StartKernel
from labos.core.decide.limits import BAD_TEXT, find_fault
from labos.core.decide.nodes import Quarantine
from labos.core.failures import SUSPICIOUS
from labos.core.ids import ActionId, LabId, ModuleName
from labos.core.invariants import find_broken_by
from labos.core.registry import Event
from labos.core.words import Keep, Kept, keep, list_references
from labos.errors import (
    BadInput,
    Forbidden,
    InternalFault,
    InvariantBroken,
    LabosError,
    Refused,
)
from labos.planning.scheduler import Scheduler
from labos.planning.touch import find_touched_keys
from labos.runtime.follower import Follower
from labos.runtime.guard import CircuitBreaker, FaultyCommands
from labos.runtime.kernel_log import KernelLog, KernelSettings
from labos.runtime.ledger import Entry, Ledger
from labos.runtime.marks import MARK
from labos.runtime.writer import Writer

VERSION = "0.1.0"

MAY_WAIT = (ActionAccepted,)
"""Events without a waiting caller: they cause no messages, and if they are lost, the node is asked and gives
the same answer again."""

FAULT = "internal_fault"
FAULT_REMEDY = "This is a fault of LabOS: report it with the lines in the kernel's log. The lab continues."

_log = structlog.get_logger(__name__)


class _Turn(msgspec.Struct):
    """The progress of a turn on a ``ledger``: its ``entries``, of which the first ``decided`` are the
    command's own, and the time of the next wake-up (``deadline``, UTC ns). A failure now counts for ``part``,
    a part of planning, or for the command if there is none; ``planned`` are the parts that were tried."""

    ledger: Ledger
    entries: list[Entry] = []
    decided: int = 0
    deadline: int | None = None
    part: CircuitBreaker | None = None
    planned: list[CircuitBreaker] = []


class Kernel(KernelLog):
    """Decides and writes for one lab. The first event of a command bears its ``causation``, else the mark of
    the request that is being carried out (``marks``). ``plan_with`` makes the scheduler, once for each
    reading of the log. People's words in commands are stored beside the log, with a ``salt`` for each
    text."""

    def __init__(
        self,
        writer: Writer,
        clock: Clock,
        ids: Ids,
        settings: KernelSettings,
        plan_with: Callable[[], Scheduler] = Scheduler,
        salt: Callable[[], bytes] = new_salt,
    ) -> None:
        super().__init__(writer, clock, ids, settings)
        self._salt = salt
        self._plan_with = plan_with
        self.scheduler = plan_with()
        self.turns = 0
        self.on_turn: Callable[[float], None] = lambda _: None
        """Called with the duration of each turn, in seconds."""
        self._starts, self._deadlines = CircuitBreaker("starts"), CircuitBreaker("deadlines")
        self._faulty = FaultyCommands()
        self._is_folded = False
        self._may_plan = False
        self._keys: set[str] = set()
        self._alarm: asyncio.TimerHandle | None = None
        self._alarm_at = 0

    # -- start and end -----------------------------------------------------------------------

    async def open(self, follower: Follower | None = None, *, plan: bool = True) -> None:
        """Take the lease, fold the log, announce the new epoch. Events that a ``follower`` has already folded
        are not folded again. Without ``plan``, no step is started and no deadline is handled before
        ``begin_planning``. Raises Refused while another kernel is running."""
        settings, self._follower = self.settings, follower
        lab = LabId(self.ids.new())
        head = await self._writer.call(lambda store: store.claim(lab, settings.owner, settings.lease_s))
        await self._read_log()
        assert self._ledger is not None
        if not self.state.lab.id:
            self._begin_with(CreateLab(head.lab, settings.name, settings.pace))
        self._begin_with(StartKernel(head.epoch, VERSION))
        await self.flush()
        self._tasks.append(asyncio.get_running_loop().create_task(self._keep_lease()))
        if plan:
            await self.begin_planning()

    async def close(self) -> None:
        if self._alarm is not None:
            self._alarm.cancel()
        await super().close()

    async def begin_planning(self) -> None:
        """Start steps from now on. If planning fails, it is suspended before this returns."""
        self._may_plan = True
        self.wake()
        while self._refolding is not None:
            await asyncio.wait({self._refolding})

    def _begin_with(self, command: Command) -> None:
        answer = self._turn(command, LABOS)
        if isinstance(answer, Rejection):
            raise make_error(answer)

    # -- commands ----------------------------------------------------------------------------

    async def execute(self, command: Command, actor: str, causation: str = "") -> list[Event]:
        """Decide a command and wait until its events are on disk; returns them. Raises Refused with the
        rejection's text, InternalFault if LabOS itself failed."""
        answer = self._turn(command, actor, causation or MARK.get())
        if isinstance(answer, Rejection):
            raise make_error(answer)
        await self.flush()
        return answer

    def submit(self, command: Command, actor: str, causation: str = "") -> list[Event] | Rejection:
        """Decide a command without waiting for the disk: for callers who report nothing to others before the
        events are on disk."""
        return self._turn(command, actor, causation or MARK.get())

    def wake(self, keys: Iterable[str] = ()) -> None:
        """Check again everything that waits for these keys, or for a time that has come."""
        if self._ledger is not None and not self._closing:
            self._keys.update(keys)
            self._turn(None, LABOS)

    def _forget(self) -> None:
        self.scheduler = self._plan_with()
        self._keys.clear()

    # -- a turn ------------------------------------------------------------------------------

    def _turn(self, command: Command | None, actor: str, causation: str = "") -> list[Event] | Rejection:
        began = self.clock.monotonic()
        answer = self._take_turn(command, actor, causation)
        try:
            self.on_turn(self.clock.monotonic() - began)
        except Exception as error:  # the decision is valid, whether its duration was measured or not
            _log.exception("turn_not_measured")
            self._record_fault(f"on_turn: {error!r}")
        return answer

    def _take_turn(self, command: Command | None, actor: str, causation: str) -> list[Event] | Rejection:
        """Decide and fold a command, plan (without a command, only plan), check, and give everything to the
        writer as one batch. If any part raises an error, the whole turn is undone."""
        turn = _Turn(self._open_ledger())
        self.turns += 1
        if fault := find_fault(actor, "actor"):
            return Rejection(BAD_TEXT, fault)
        now_s = self.clock.monotonic()
        if command is not None and (why := self._faulty.explain_refusal(command, now_s)):
            return Rejection(FAULT, why, FAULT_REMEDY)
        events: list[Event] = []
        self._is_folded = False
        try:
            if command is not None:
                decided = self._take_command(command, turn, actor, causation)
                if isinstance(decided, Rejection):
                    return decided
                events = decided
            turn.decided = len(turn.entries)
            self._plan(turn, is_wake=command is None)
            if self.settings.check_invariants and turn.entries:
                self._check(turn)
        except Exception as error:  # after any error, memory must not be ahead of the log
            return self._fail_turn(error, command, turn)
        for part in turn.planned:
            if part.why:
                _log.info("planning_works_again", part=part.name)
                part.record_success()
        self._pass_on(turn.entries)
        self._set_alarm(turn.deadline)
        return events

    def _fail_turn(self, error: Exception, command: Command | None, turn: _Turn) -> Rejection:
        """Undo a turn, and remember the cause of its failure."""
        now_s = self.clock.monotonic()
        name = "planning" if command is None else type(command).__name__
        fault = error.message if isinstance(error, InvariantBroken) else repr(error)
        why = f"LabOS failed on {name}, and nothing of it was done: {fault}"
        _log.error("turn_failed", turn=name, fault=fault, exc_info=error)
        self._record_fault(why)
        if turn.part is not None:
            turn.part.record_failure(now_s, fault)
            if turn.part.is_open:
                _log.error("planning_suspended", part=turn.part.name, why=fault)
        if self._is_folded:
            self._take_back(why)
        elif turn.part is not None:
            self.scheduler = self._plan_with()
            self._set_alarm(None)
        if command is not None:
            self._faulty.record(command, now_s, why)
        return Rejection(FAULT, why, FAULT_REMEDY)

    def _take_command(
        self, command: Command, turn: _Turn, actor: str, causation: str
    ) -> list[Event] | Rejection:
        """Carry out a request. People's words are stored beside the log, together with the first event that
        refers to them."""
        if actor == LABOS or "/" in actor:  # a module
            return self._carry_out(command, turn, actor, causation)
        kept: dict[str, Kept] = {}

        def keep_words(text: str) -> str:
            words = keep(text, self._salt())
            kept[words.reference] = words
            return words.reference

        decided = self._carry_out(command, turn, actor, causation, keep_words)
        if kept:
            _attach(kept, turn.entries)
        return decided

    def _carry_out(
        self,
        command: Command,
        turn: _Turn,
        actor: str,
        causation: str,
        keep_words: Keep | None = None,
    ) -> list[Event] | Rejection:
        """Decide a command and fold its events and the reactions to them, which are added to those of the
        turn. The first is caused by ``causation``, the others by the first."""
        ledger, entries = turn.ledger, turn.entries
        begin = len(entries)

        def write(event: Event) -> Event:
            self._is_folded = True
            cause = entries[begin].record.head.id if len(entries) > begin else causation
            entries.append(ledger.write(event, actor, cause))
            return entries[-1].event

        events = carry_out(ledger.state, command, write, actor, keep_words)
        for entry in entries[begin:]:
            self._keys.update(find_touched_keys(ledger.state, entry.event))
        return events

    def _plan(self, turn: _Turn, *, is_wake: bool) -> None:
        """Carry out everything that is due, and start all steps that may start. A part that fails repeatedly
        is suspended: commands are carried out without it, and it is tried again later."""
        state, now_s = turn.ledger.state, self.clock.monotonic()
        parts = [part for part in (self._deadlines, self._starts) if part.allows(now_s, is_wake)]
        parts = parts if self._may_plan else []
        looked_at = 0
        while parts:
            before = len(turn.entries)
            keys, self._keys = self._keys, set()
            turn.part = parts[0]
            self.scheduler.note_changes(state, keys)
            if self._deadlines in parts:
                turn.part = self._deadlines
                self._carry_out_due(turn, looked_at)
            looked_at = len(turn.entries)
            if self._starts in parts:
                turn.part = self._starts
                self._start_steps(turn)
                if len(turn.entries) == before:
                    self._grant_access(turn)
            if len(turn.entries) == before:
                break
        if self._deadlines in parts:
            turn.part = self._deadlines
            turn.deadline = self.scheduler.find_next_deadline(state)
        elif self._starts in parts:
            turn.deadline = self.scheduler.find_next_wake()
        # An invariant that breaks now may be broken by an event of planning.
        turn.part = self._starts if len(turn.entries) > turn.decided else None
        turn.planned = parts

    def _start_steps(self, turn: _Turn) -> None:
        now = self.clock.now_ns()
        for start in self.scheduler.iterate_proposals(turn.ledger.state, now):
            self._decide_follow_up(start.make_command(lambda: ActionId(self.ids.new()), now), turn)

    def _carry_out_due(self, turn: _Turn, looked_at: int) -> None:
        """Carry out everything that is due at this time, and the quarantine of modules that fail too often,
        for the entries from ``looked_at`` on."""
        now = self.clock.now_ns()
        for command in self.scheduler.iterate_due(turn.ledger.state, now):
            self._decide_follow_up(command, turn)
        for suspect in self._list_suspects(turn.entries[looked_at:]):
            limits = (self.settings.quarantine_after, self.settings.quarantine_within_s)
            self._decide_follow_up(Quarantine(suspect, *limits, now), turn)

    def _list_suspects(self, entries: Sequence[Entry]) -> list[ModuleName]:
        """Modules that may have failed too often."""
        if not self.settings.quarantine_after:
            return []
        return list(dict.fromkeys(e.event.module for e in entries if isinstance(e.event, SUSPICIOUS)))

    def _grant_access(self, turn: _Turn) -> None:
        """There is nothing more to start: waiting requests for access are granted where nothing moves."""
        for cell, access in list(turn.ledger.state.lab.access.items()):
            if not access.granted:
                self._decide_follow_up(GrantAccess(cell), turn)

    def _decide_follow_up(self, command: Command, turn: _Turn) -> None:
        cause = turn.entries[-1].record.head.id if turn.entries else ""
        decided = self._carry_out(command, turn, LABOS, cause)
        if isinstance(decided, Rejection):
            # Planning proposes only what the rules allow: a rejection is a fault of LabOS.
            _log.error("proposal_rejected", command=repr(command), why=decided.message)
            self._record_fault(f"{command!r}: {decided.message}")

    def _check(self, turn: _Turn) -> None:
        events = [entry.event for entry in turn.entries]
        fault = find_broken_by(turn.ledger.state, events)
        if fault:
            names = ", ".join(event.TYPE for event in events)
            raise InvariantBroken(f"[{names}] would break an invariant: {fault}")

    def _pass_on(self, entries: list[Entry]) -> None:
        """Give the batch to the writer."""
        if entries:
            self._unwritten.extend(entries)
            may_wait = all(isinstance(entry.event, MAY_WAIT) for entry in entries)
            self._writer.submit([entry.record for entry in entries], may_wait=may_wait)

    def _set_alarm(self, deadline: int | None) -> None:
        """Wake at ``deadline`` (UTC ns), or when suspended planning will be tried again."""
        for part in (self._deadlines, self._starts):
            if part.retry_at is not None:
                pause_s = max(part.retry_at - self.clock.monotonic(), 0.0)
                retry_at = self.clock.now_ns() + int(pause_s * 1e9) + 1
                deadline = retry_at if deadline is None else min(deadline, retry_at)
        if self._alarm is not None:
            if deadline == self._alarm_at:
                return
            self._alarm.cancel()
            self._alarm = None
        if deadline is not None and not self._closing:
            delay = max(deadline - self.clock.now_ns(), 0) / 1e9
            self._alarm_at = deadline
            self._alarm = asyncio.get_running_loop().call_later(delay, self._wake_up)

    def _wake_up(self) -> None:
        self._alarm = None
        if self._ledger is not None:
            self.wake()

    @property
    def suspended(self) -> str:
        """Why nothing is started: the failure of planning. Empty while planning works."""
        return self._starts.why if self._starts.is_open else ""


def _attach(kept: dict[str, Kept], entries: list[Entry]) -> None:
    """Attach each text to the first record that refers to it. Texts without a reference are not stored."""
    for at, entry in enumerate(entries):
        named = list_references(entry.record.payload)
        words = tuple(found for name in named if (found := kept.pop(name, None)) is not None)
        if words:
            record = msgspec.structs.replace(entry.record, words=words)
            entries[at] = msgspec.structs.replace(entry, record=record)


def make_error(rejection: Rejection) -> LabosError:
    """The error for a command that was refused."""
    if isinstance(rejection, Denied):
        return Forbidden(rejection.message, remedy=rejection.remedy)
    kinds: dict[str, type[LabosError]] = {FAULT: InternalFault, BAD_TEXT: BadInput}
    return kinds.get(rejection.code, Refused)(rejection.message, remedy=rejection.remedy)
