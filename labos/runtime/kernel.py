"""The kernel: the one process that decides and writes.

A *turn* takes one command: ``decide`` answers with events, the events are folded, planning
proposes starts, ``decide`` enforces each of them, and the whole is one batch for the writer. What
the outside hears of it (replies, requests to nodes) waits until the batch is on disk.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any, Protocol

import msgspec
import structlog

from labos.clock import Clock, Ids
from labos.core.actions import ActionAccepted, ActionRequested
from labos.core.decide import Command, Rejection, decide
from labos.core.decide.access import GrantAccess
from labos.core.decide.actions import StartStep
from labos.core.decide.experiments import AskAboutClosing
from labos.core.decide.lab import CreateLab, StartKernel
from labos.core.decide.limits import BAD_TEXT, fault_of
from labos.core.decide.nodes import EndOutage, Quarantine
from labos.core.decide.runs import BreachWindow
from labos.core.decide.steps import TimeOutAction
from labos.core.decide.work import NoteOverdue
from labos.core.failures import SUSPICIOUS
from labos.core.ids import ActionId, LabId, ModuleName
from labos.core.invariants import broken_by
from labos.core.lab import KernelStarted
from labos.core.registry import Event, decode
from labos.core.state import LabState
from labos.errors import (
    BadInput,
    CommitInDoubt,
    Fenced,
    InternalFault,
    InvariantBroken,
    LabosError,
    Refused,
    StoreError,
    StoreUnavailable,
)
from labos.planning.scheduler import Scheduler
from labos.planning.touch import touched
from labos.ports import EventStore, LogQuery
from labos.runtime.follower import Follower
from labos.runtime.guard import CircuitBreaker, FaultyCommands
from labos.runtime.ledger import Entry, Ledger, load, snapshot
from labos.runtime.writer import PatientWriter, Writer

VERSION = "0.1.0"

MAY_WAIT = (ActionAccepted,)
"""Events for which nobody waits: nothing is sent because of them, and should they be lost, the
node is asked and says the same again."""

LONGEST_PAUSE_S = 5.0
"""Between two tries to get the store back."""

FAULT = "internal_fault"
FAULT_REMEDY = "This is a fault of LabOS: report it with what the kernel's log says. The lab goes on."

_log = structlog.get_logger(__name__)


class Listener(Protocol):
    """Hears of events once they are on disk, in order."""

    def committed(self, entries: Sequence[Entry]) -> None: ...

    def reopened(self) -> None:
        """The log was read again: what was decided but not written is forgotten."""


class KernelSettings(msgspec.Struct, frozen=True):
    """``lease_s`` is how long a silent kernel keeps the lab; ``snapshot_every`` counts events;
    ``reopen_s`` is how long the kernel tries to get its store back before it stops: 0 for not at all,
    infinity for ever. A module that fails ``quarantine_after`` times (0: however often) within
    ``quarantine_within_s`` lab seconds is taken out of service."""

    name: str = "lab"
    pace: float = 1.0
    owner: str = "kernel"
    lease_s: float = 6.0
    snapshot_every: int = 50_000
    reopen_s: float = 30.0
    quarantine_after: int = 0
    quarantine_within_s: float = 600.0
    check_invariants: bool = True


class _Turn(msgspec.Struct):
    """How far a turn has come: its ``entries``, of which the first ``decided`` are the commands' own; when to
    wake next (``deadline``, UTC ns). ``part`` is the part of planning that a failure now is put down to,
    none if it is the commands' own; ``planned`` are the parts that were tried."""

    entries: list[Entry]
    decided: int = 0
    deadline: int | None = None
    part: CircuitBreaker | None = None
    planned: list[CircuitBreaker] = []


class Kernel:
    """Decides and writes for one lab. ``plan_with`` makes the scheduler, once for each reading
    of the log."""

    def __init__(
        self,
        writer: Writer,
        clock: Clock,
        ids: Ids,
        settings: KernelSettings,
        plan_with: Callable[[], Scheduler] = Scheduler,
    ) -> None:
        self.settings = settings
        self.clock, self.ids = clock, ids
        self._plan_with = plan_with
        self.scheduler = plan_with()
        self.listeners: list[Listener] = []
        self.failed: asyncio.Future[LabosError] = asyncio.get_running_loop().create_future()
        self.durable = 0
        self.turns = 0
        self.faults: deque[str] = deque(maxlen=100)
        """What it had to refuse of its own: proposals against the rules, batches against an invariant."""
        self._starts, self._deadlines = CircuitBreaker("starts"), CircuitBreaker("deadlines")
        self._faulty = FaultyCommands()
        self._is_folded = False
        self._may_plan = False
        self._refolding: asyncio.Task[None] | None = None
        self._writer = PatientWriter(writer)
        self._ledger: Ledger | None = None
        self._unwritten: deque[Entry] = deque()
        self._waiting: deque[tuple[int, asyncio.Future[None]]] = deque()
        self._keys: set[str] = set()
        self._tasks: list[asyncio.Task[None]] = []
        self._alarm: asyncio.TimerHandle | None = None
        self._alarm_at = 0
        self._snapshot_at = 0
        self._picture: tuple[int, bytes, str, bytes] | None = None
        self._closing = False
        self._lost_at: float | None = None
        self._lost_why: LabosError | None = None
        self._losses = 0
        self._epoch_claimed: int | None = None
        self._follower: Follower | None = None

    # -- life --------------------------------------------------------------------------------

    async def open(self, follower: Follower | None = None, *, plan: bool = True) -> None:
        """Take the lease, fold the log, announce the new epoch. What a ``follower`` has read already is
        not folded again. Without ``plan`` nothing is started, nor looked at for its time, before
        ``begin_planning``. Raises Refused while another kernel lives."""
        settings, self._follower = self.settings, follower
        lab = LabId(self.ids.new())
        head = await self._writer.call(lambda store: store.claim(lab, settings.owner, settings.lease_s))
        await self._read_log()
        assert self._ledger is not None
        if not self.state.lab.id:
            self._begin_with(CreateLab(head.lab, settings.name, settings.pace))
        self._begin_with(StartKernel(head.epoch, VERSION))
        await self.written()
        self._tasks.append(asyncio.get_running_loop().create_task(self._keep_lease()))
        if plan:
            await self.begin_planning()

    async def begin_planning(self) -> None:
        """Start what may start from now on. Planning that fails is suspended before this returns."""
        self._may_plan = True
        self.wake()
        while self._refolding is not None:
            await asyncio.wait({self._refolding})

    def _begin_with(self, command: Command) -> None:
        answer = self._turn((command,), "labos")
        if isinstance(answer, Rejection):
            raise _error_of(answer)

    async def close(self) -> None:
        """Write what is decided, keep a snapshot, give the lease back. ``failed`` says so if what was
        decided last could not be written."""
        self._closing = True
        if self._alarm is not None:
            self._alarm.cancel()
        if self._refolding is not None:
            await asyncio.wait({self._refolding}, timeout=LONGEST_PAUSE_S)
        for task in self._tasks:
            task.cancel()
        if self._epoch_claimed is not None and not self.failed.done():
            try:
                await self.written()
            except StoreError as error:
                self._stop(self._lost_why or error)
            else:
                await self._leave()
        await self._writer.close()

    async def _leave(self) -> None:
        ledger = self._open_ledger()
        picture = snapshot(ledger.state, ledger.head)
        try:
            await self._writer.call(lambda store: store.save_snapshot(*picture))
            await self._writer.call(lambda store: store.release(ledger.head.epoch))
        except StoreError as error:
            _log.warning("lease_not_given_back", why=str(error))

    @property
    def state(self) -> LabState:
        """The speculative state: everything decided so far. Read it, never change it."""
        return self._open_ledger().state

    @property
    def lab(self) -> LabId:
        return self._open_ledger().head.lab

    @property
    def epoch(self) -> int:
        return self._open_ledger().head.epoch

    # -- commands ----------------------------------------------------------------------------

    async def execute(self, command: Command, actor: str, causation: str = "") -> list[Event]:
        """Decide a command and wait until its events are on disk; returns them. Raises Refused
        with the rejection's words, InternalFault if LabOS itself failed on it."""
        return await self.execute_all((command,), actor, causation)

    async def execute_all(self, commands: Sequence[Command], actor: str, causation: str = "") -> list[Event]:
        """Several commands, one after the other, as one batch: all of them happen, or none. Raises as
        ``execute`` does."""
        answer = self._turn(commands, actor, causation)
        if isinstance(answer, Rejection):
            raise _error_of(answer)
        await self.written()
        return answer

    def submit(self, command: Command, actor: str, causation: str = "") -> list[Event] | Rejection:
        """Decide a command without waiting for the disk: for callers that promise nothing to
        anybody on the strength of it."""
        return self._turn((command,), actor, causation)

    async def written(self) -> None:
        """Wait until everything decided so far is on disk. Raises StoreError if it is lost."""
        ledger = self._open_ledger()
        if self.durable >= ledger.head.position:
            return
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.append((ledger.head.position, future))
        self._writer.flush()
        await future

    async def starts(self) -> list[tuple[int, int]]:
        """The epochs of this log's kernels, and the positions where they began. Raises StoreError."""

        def look(store: EventStore) -> list[tuple[int, int]]:
            found = store.select(LogQuery(types=(KernelStarted.TYPE,)))
            mine = [record for record in found if record.head.type == KernelStarted.TYPE]
            events = [decode(record.head.type, record.head.schema, record.payload) for record in mine]
            pairs = zip(events, mine, strict=True)
            return [(e.epoch, r.head.position) for e, r in pairs if isinstance(e, KernelStarted)]

        return await self._writer.call(look)

    async def holds_request(self, action: ActionId, position: int) -> bool:
        """Whether a request of this action stands at a position of the log. Raises StoreError."""
        if not 0 < position <= self.durable:
            return False

        def look(store: EventStore) -> bool:
            heads = [(r.head.type, r) for r in store.read(position - 1, position)]
            requests = [r for kind, r in heads if kind == ActionRequested.TYPE]
            events = [decode(r.head.type, r.head.schema, r.payload) for r in requests]
            return any(isinstance(e, ActionRequested) and e.action == action for e in events)

        return await self._writer.call(look)

    async def check_lease(self) -> None:
        """Ask the database whether this is still the lab's kernel; if it is not, the kernel stops. Raises
        Fenced then, StoreError if the database does not say."""
        epoch, lease = self.epoch, self.settings.lease_s
        try:
            await self._writer.call(lambda store: store.renew(epoch, lease))
        except Fenced as error:
            self._lose(error)
            raise

    def wake(self, keys: Iterable[str] = ()) -> None:
        """Look again at what waits for these keys, or for the time that has come."""
        if self._ledger is not None and not self._closing:
            self._keys.update(keys)
            self._turn((), "labos")

    # -- a turn ------------------------------------------------------------------------------

    def _turn(self, commands: Sequence[Command], actor: str, causation: str = "") -> list[Event] | Rejection:
        """Decide and fold the commands, plan, check, and hand everything to the writer as one batch. If
        anything raises on the way, nothing of it has happened."""
        ledger = self._open_ledger()
        self.turns += 1
        if fault := fault_of(actor, "actor"):
            return Rejection(BAD_TEXT, fault)
        now_s = self.clock.monotonic()
        for command in commands:
            if why := self._faulty.why_refused(command, now_s):
                return Rejection(FAULT, why, FAULT_REMEDY)
        events: list[Event] = []
        entries: list[Entry] = []
        turn = _Turn(entries)
        self._is_folded = False
        try:
            for command in commands:
                decision = decide(ledger.state, command)
                if isinstance(decision, Rejection):
                    if self._is_folded:
                        self._take_back(f"{_name(commands)} was refused: {decision.message}")
                    return decision
                entries += self._write(decision, actor, causation)
                events += decision
            turn.decided = len(entries)
            self._plan(turn, is_wake=not commands)
            if self.settings.check_invariants and entries:
                self._check([entry.event for entry in entries])
        except Exception as error:  # whatever it is, memory must not stay ahead of the log
            return self._fail_turn(error, commands, turn)
        for part in turn.planned:
            if part.why:
                _log.info("planning_works_again", part=part.name)
                part.record_success()
        self._pass_on(entries)
        self._set_alarm(turn.deadline)
        return events

    def _fail_turn(self, error: Exception, commands: Sequence[Command], turn: _Turn) -> Rejection:
        """Take a turn back, and remember what made it fail."""
        now_s = self.clock.monotonic()
        name = _name(commands)
        fault = error.message if isinstance(error, InvariantBroken) else repr(error)
        why = f"LabOS failed on {name}, and nothing of it was done: {fault}"
        _log.error("turn_failed", turn=name, fault=fault, exc_info=error)
        self.faults.append(why)
        if turn.part is not None:
            turn.part.record_failure(now_s, fault)
            if turn.part.is_open:
                _log.error("planning_suspended", part=turn.part.name, why=fault)
        if self._is_folded:
            self._take_back(why)
        elif turn.part is not None:
            self.scheduler = self._plan_with()
            self._set_alarm(None)
        for command in commands:
            self._faulty.record(command, now_s, why)
        return Rejection(FAULT, why, FAULT_REMEDY)

    def _take_back(self, why: str) -> None:
        """Forget what was folded in this turn. Earlier turns are with the writer already: the log is read
        again behind them."""
        self._ledger = None
        self._picture = None
        self._lost_why = StoreUnavailable(
            f"The log is being read again: {why}.", remedy="Try again in a moment."
        )
        self._refolding = asyncio.get_running_loop().create_task(self._refold())
        self._tasks.append(self._refolding)

    async def _refold(self) -> None:
        try:
            await self._read_log()
        except Fenced as error:
            self._refolding = None
            self._stop(error)
        except Exception as error:
            self._refolding = None
            await self._reopen(_store_error(error))
        else:
            self._refolding = None  # what follows may fail again
            self._go_on()

    def _write(self, events: Sequence[Event], actor: str, causation: str = "") -> list[Entry]:
        ledger = self._open_ledger()
        self._is_folded = self._is_folded or bool(events)
        entries = ledger.write(events, actor, causation)
        for entry in entries:
            self._keys.update(touched(ledger.state, entry.event))
        return entries

    def _plan(self, turn: _Turn, *, is_wake: bool) -> None:
        """Carry out what is due, and start what may start. A part that keeps failing is suspended: commands
        are carried out without it, and it is tried again by itself."""
        now_s = self.clock.monotonic()
        parts = [part for part in (self._deadlines, self._starts) if part.allows(now_s, is_wake)]
        parts = parts if self._may_plan else []
        looked_at = 0
        while parts:
            before = len(turn.entries)
            keys, self._keys = self._keys, set()
            turn.part = parts[0]
            self.scheduler.heed(self.state, keys)
            if self._deadlines in parts:
                turn.part = self._deadlines
                self._carry_out_due(turn.entries, looked_at)
            looked_at = len(turn.entries)
            if self._starts in parts:
                turn.part = self._starts
                self._start_steps(turn.entries, keys)
                if len(turn.entries) == before:
                    self._grant_access(turn.entries)
            if len(turn.entries) == before:
                break
        if self._deadlines in parts:
            turn.part = self._deadlines
            turn.deadline = self.scheduler.next_deadline(self.state)
        elif self._starts in parts:
            turn.deadline = self.scheduler.next_wake()
        # What breaks an invariant now may be what planning has added.
        turn.part = self._starts if len(turn.entries) > turn.decided else None
        turn.planned = parts

    def _start_steps(self, entries: list[Entry], keys: set[str]) -> None:
        now = self.clock.now_ns()
        for start in self.scheduler.proposals(self.state, keys, now):
            action = ActionId(self.ids.new())
            self._decide_too(StartStep(start.run, start.step, action, now), entries)

    def _carry_out_due(self, entries: list[Entry], looked_at: int) -> None:
        """What the time that has come asks for, and the quarantine of modules that fail too often, in the
        entries from ``looked_at`` on."""
        now = self.clock.now_ns()
        for command in self._due(self.state, now):
            self._decide_too(command, entries)
        for suspect in self._suspects(entries[looked_at:]):
            limits = (self.settings.quarantine_after, self.settings.quarantine_within_s)
            self._decide_too(Quarantine(suspect, *limits, now), entries)

    def _due(self, state: LabState, now: int) -> Iterator[Command]:
        for breach in self.scheduler.breaches(state, now):
            yield BreachWindow(breach.run, breach.step, breach.window, now)
        for late in self.scheduler.timed_out(state, now):
            yield TimeOutAction(late, now)
        for module in self.scheduler.outages_over(state, now):
            yield EndOutage(module, now)
        for run in self.scheduler.closing_late(state, now):
            yield AskAboutClosing(run, now)
        for question in self.scheduler.unanswered(state, now):
            yield NoteOverdue(question, now)
        yield from self.scheduler.leaving(state)

    def _suspects(self, entries: Sequence[Entry]) -> list[ModuleName]:
        """Modules that may have failed once too often."""
        if not self.settings.quarantine_after:
            return []
        found = {e.event.module: True for e in entries if isinstance(e.event, SUSPICIOUS)}
        return list(found)

    def _grant_access(self, entries: list[Entry]) -> None:
        """Nothing is left to start: who waits to reach in may, where nothing moves."""
        for cell, access in list(self.state.lab.access.items()):
            if not access.granted:
                self._decide_too(GrantAccess(cell), entries)

    def _decide_too(self, command: Command, entries: list[Entry]) -> None:
        decision = decide(self.state, command)
        if isinstance(decision, Rejection):
            # Planning proposes only what the rules allow: a rejection is a fault of ours.
            _log.error("proposal_rejected", command=repr(command), why=decision.message)
            self.faults.append(f"{command!r}: {decision.message}")
            return
        cause = entries[-1].record.head.id if entries else ""
        entries.extend(self._write(decision, "labos", cause))

    def _check(self, events: Sequence[Event]) -> None:
        fault = broken_by(self.state, events)
        if fault:
            names = ", ".join(event.TYPE for event in events)
            raise InvariantBroken(f"[{names}] would break what must always hold: {fault}")

    def _pass_on(self, entries: list[Entry]) -> None:
        """Hand the batch to the writer."""
        if entries:
            self._unwritten.extend(entries)
            may_wait = all(isinstance(entry.event, MAY_WAIT) for entry in entries)
            self._writer.submit([entry.record for entry in entries], may_wait=may_wait)

    def _set_alarm(self, deadline: int | None) -> None:
        """Wake at ``deadline`` (UTC ns), or when planning that failed is to be tried again."""
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
            self._alarm = asyncio.get_running_loop().call_later(delay, self._ring)

    def _ring(self) -> None:
        self._alarm = None
        if self._ledger is not None:
            self.wake()

    @property
    def suspended(self) -> str:
        """Why nothing is started: what planning fails on. Empty while it works."""
        return self._starts.why if self._starts.is_open else ""

    # -- what the writer says ----------------------------------------------------------------

    def _on_durable(self, position: int) -> None:
        self.durable = position
        self._losses = 0
        self._lost_at = None
        entries: list[Entry] = []
        while self._unwritten and self._unwritten[0].position <= position:
            entries.append(self._unwritten.popleft())
        for listener in self.listeners:
            if not self._notify(listener, partial(listener.committed, entries)):
                self._notify(listener, listener.reopened)  # it looks at everything again
        while self._waiting and self._waiting[0][0] <= position:
            future = self._waiting.popleft()[1]
            if not future.done():
                future.set_result(None)
        self._keep_snapshot(position)

    def _on_failure(self, error: StoreError) -> None:
        _log.error("commit_failed", error=str(error))
        self._lose(error)

    def _lose(self, error: StoreError) -> None:
        """Forget everything that is not on disk for sure; then, unless this is the end anyway, read the
        log again. Errors that come while that is under way are more of the same."""
        reopening, self._ledger = self._ledger is None, None
        self._lost_why = error
        self._unwritten.clear()
        self._picture = None
        told = in_doubt(error) if type(error) is StoreUnavailable else error
        waiting, self._waiting = self._waiting, deque()
        for _, future in waiting:
            if not future.done():
                future.set_exception(told)
        if self._closing:
            return
        if isinstance(error, Fenced):
            self._stop(error)
        elif not reopening:
            self._tasks.append(asyncio.get_running_loop().create_task(self._reopen(error)))

    async def _reopen(self, error: LabosError) -> None:
        """Get the log back after a commit of unknown outcome. A database that can be read but not
        written (a full disk) is not back: its lease is renewed to see."""
        began = self.clock.monotonic()
        if self._lost_at is None or began - self._lost_at > 2 * max(self.settings.reopen_s, LONGEST_PAUSE_S):
            self._lost_at, self._losses = began, 0
        give_up = self._lost_at + self.settings.reopen_s
        epoch, lease = self._epoch_claimed, self.settings.lease_s
        while self.clock.monotonic() < give_up:
            if self._losses:
                await asyncio.sleep(min(0.1 * 2 ** min(self._losses, 10), LONGEST_PAUSE_S))
            self._losses += 1
            try:
                if epoch is not None:
                    await self._writer.call(lambda store: store.renew(epoch, lease))
                await self._read_log()
            except Fenced as fenced:
                self._stop(fenced)
                return
            except Exception as again:
                error = self._lost_why = _store_error(again)
                continue
            self._go_on()
            return
        self._stop(error)

    def _go_on(self) -> None:
        """The log was read again."""
        _log.warning("log_reopened", position=self.durable)
        for listener in self.listeners:
            self._notify(listener, listener.reopened)
        self.wake()

    def _notify(self, listener: Listener, call: Callable[[], None]) -> bool:
        """Tell a listener. One that fails does not keep the others from hearing."""
        try:
            call()
        except StoreError as error:
            _log.info("listener_waits_for_log", listener=type(listener).__name__, why=str(error))
        except Exception as error:
            _log.exception("listener_failed", listener=type(listener).__name__)
            self.faults.append(f"{type(listener).__name__}: {error!r}")
            return False
        return True

    def _stop(self, error: LabosError) -> None:
        _log.error("kernel_stopped", error=str(error))
        if not self.failed.done():
            self.failed.set_result(error)

    # -- the log -----------------------------------------------------------------------------

    async def _read_log(self) -> None:
        known = self._epoch_claimed

        def read(store: EventStore) -> tuple[Any, LabState]:
            head = store.head()
            if known is not None and head.epoch != known:
                raise Fenced(
                    f"Another kernel (epoch {head.epoch}) has taken over this lab.",
                    remedy="Let it work; this one must not go on.",
                )
            follower, self._follower = self._follower, None
            state, _ = load(store, begin=follower.hand_over() if follower is not None else None, end=head)
            return head, state

        head, state = await self._writer.call(read)
        if state.position != head.position:
            raise StoreUnavailable(f"The log ends at {head.position}, but {state.position} could be read.")
        self._epoch_claimed = head.epoch
        self._ledger = Ledger(state, head, self.clock, self.ids)
        self.durable = head.position
        self.scheduler = self._plan_with()
        self._keys.clear()
        self._snapshot_at = head.position
        self._writer.begin(head, self._on_durable, self._on_failure)

    def _keep_snapshot(self, position: int) -> None:
        ledger = self._ledger
        if ledger is None:
            return
        if self._picture is not None and position >= self._picture[0]:
            picture, self._picture = self._picture, None
            task = asyncio.get_running_loop().create_task(
                self._writer.call(lambda store: store.save_snapshot(*picture))
            )
            task.add_done_callback(_swallow_store_error)
        if ledger.head.position - self._snapshot_at >= self.settings.snapshot_every:
            self._snapshot_at = ledger.head.position
            self._picture = snapshot(ledger.state, ledger.head)

    async def _keep_lease(self) -> None:
        lease = self.settings.lease_s
        epoch = self.epoch
        while True:
            await asyncio.sleep(lease / 3)
            try:
                await self._writer.call(lambda store: store.renew(epoch, lease))
            except Fenced as error:
                self._lose(error)
                return
            except Exception as error:
                # Nothing was decided meanwhile, and nothing could be: an idle lab has lost its log too.
                if self._ledger is not None:
                    _log.error("lease_not_renewed", error=str(error))
                self._lose(_store_error(error))

    def _open_ledger(self) -> Ledger:
        if self._ledger is None:
            why = self._lost_why
            if why is None:
                raise StoreUnavailable("The log is still being read.", remedy="Try again in a moment.")
            raise StoreUnavailable(why.message, remedy=why.remedy)
        return self._ledger


def _swallow_store_error(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and isinstance(task.exception(), StoreError):
        _log.warning("snapshot_not_saved", error=str(task.exception()))


def _error_of(rejection: Rejection) -> LabosError:
    kinds: dict[str, type[LabosError]] = {FAULT: InternalFault, BAD_TEXT: BadInput}
    return kinds.get(rejection.code, Refused)(rejection.message, remedy=rejection.remedy)


def _store_error(error: Exception) -> StoreError:
    if isinstance(error, StoreError):
        return error
    _log.error("log_not_read", exc_info=error)
    return StoreUnavailable(f"The log could not be read: {error!r}.", remedy="This is a fault of LabOS.")


def _name(commands: Sequence[Command]) -> str:
    return " and ".join(type(command).__name__ for command in commands) or "planning"


def in_doubt(error: StoreUnavailable) -> CommitInDoubt:
    """What whoever waits for a commit is told when the store failed in the midst of it."""
    remedy = f"{error.remedy} Look with `labos log` before you ask for the same again.".strip()
    return CommitInDoubt(error.message, remedy=remedy)
