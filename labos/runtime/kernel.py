"""The kernel: the one process that decides and writes.

A *turn* takes one command: ``decide`` answers with events, the events are folded, planning
proposes starts, ``decide`` enforces each of them, and the whole is one batch for the writer. What
the outside hears of it (replies, requests to nodes) waits until the batch is on disk.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Protocol

import msgspec
import structlog

from labos.clock import Clock, Ids
from labos.core.actions import ActionAccepted
from labos.core.decide import Command, Rejection, decide
from labos.core.decide.access import GrantAccess
from labos.core.decide.actions import StartStep
from labos.core.decide.lab import CreateLab, StartKernel
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
    CommitInDoubt,
    Fenced,
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
from labos.runtime.ledger import Entry, Ledger, load, snapshot
from labos.runtime.writer import PatientWriter, Writer

VERSION = "0.1.0"

MAY_WAIT = (ActionAccepted,)
"""Events for which nobody waits: nothing is sent because of them, and should they be lost, the
node is asked and says the same again."""

LONGEST_PAUSE_S = 5.0
"""Between two tries to get the store back."""

BREAKS_BORNE = 3
"""So many refused batches in a row, with nothing written in between, and the kernel stops."""

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
        self._breaks = 0
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

    async def open(self, follower: Follower | None = None) -> None:
        """Take the lease, fold the log, announce the new epoch. What a ``follower`` has read already is
        not folded again. Raises Refused while another kernel lives."""
        settings, self._follower = self.settings, follower
        lab = LabId(self.ids.new())
        head = await self._writer.call(lambda store: store.claim(lab, settings.owner, settings.lease_s))
        await self._read_log()
        assert self._ledger is not None
        if not self.state.lab.id:
            self._turn(CreateLab(head.lab, settings.name, settings.pace), "labos")
        self._turn(StartKernel(head.epoch, VERSION), "labos")
        await self.written()
        self._tasks.append(asyncio.get_running_loop().create_task(self._keep_lease()))

    async def close(self) -> None:
        """Write what is decided, keep a snapshot, give the lease back. ``failed`` says so if what was
        decided last could not be written."""
        self._closing = True
        if self._alarm is not None:
            self._alarm.cancel()
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
        with the rejection's words."""
        answer = self._turn(command, actor, causation)
        if isinstance(answer, Rejection):
            raise Refused(answer.message, remedy=answer.remedy)
        await self.written()
        return answer

    def submit(self, command: Command, actor: str, causation: str = "") -> list[Event] | Rejection:
        """Decide a command without waiting for the disk: for callers that promise nothing to
        anybody on the strength of it."""
        return self._turn(command, actor, causation)

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

    def wake(self, keys: Iterable[str] = ()) -> None:
        """Look again at what waits for these keys, or for the time that has come."""
        if self._ledger is not None and not self._closing:
            self._keys.update(keys)
            self._plan_and_pass_on([])

    # -- a turn ------------------------------------------------------------------------------

    def _turn(self, command: Command, actor: str, causation: str = "") -> list[Event] | Rejection:
        ledger = self._open_ledger()
        self.turns += 1
        decision = decide(ledger.state, command)
        if isinstance(decision, Rejection):
            return decision
        entries = self._write(decision, actor, causation)
        self._plan_and_pass_on(entries)
        return decision

    def _write(self, events: Sequence[Event], actor: str, causation: str = "") -> list[Entry]:
        ledger = self._open_ledger()
        try:
            entries = ledger.write(events, actor, causation)
        except (LookupError, ValueError, TypeError, AttributeError) as error:
            self._break(f"an event contradicts the state ({error!r})", events)
        for entry in entries:
            self._keys.update(touched(ledger.state, entry.event))
        return entries

    def _plan_and_pass_on(self, entries: list[Entry]) -> None:
        """Plan on what has changed, check the whole batch, hand it to the writer."""
        ledger = self._open_ledger()
        state = ledger.state
        looked_at = 0
        while True:
            now = self.clock.now_ns()
            keys, self._keys = self._keys, set()
            before = len(entries)
            self.scheduler.heed(state, keys)
            for breach in self.scheduler.breaches(state, now):
                self._decide_too(BreachWindow(breach.run, breach.step, breach.window, now), entries)
            for late in self.scheduler.timed_out(state, now):
                self._decide_too(TimeOutAction(late, now), entries)
            for module in self.scheduler.outages_over(state, now):
                self._decide_too(EndOutage(module, now), entries)
            for question in self.scheduler.unanswered(state, now):
                self._decide_too(NoteOverdue(question, now), entries)
            for command in self.scheduler.leaving(state):
                self._decide_too(command, entries)
            for suspect in self._suspects(entries[looked_at:]):
                limits = (self.settings.quarantine_after, self.settings.quarantine_within_s)
                self._decide_too(Quarantine(suspect, *limits, now), entries)
            looked_at = len(entries)
            for start in self.scheduler.proposals(state, keys, now):
                action = ActionId(self.ids.new())
                self._decide_too(StartStep(start.run, start.step, action, now), entries)
            if len(entries) == before and not self._grant_access(state, entries):
                break
        if self.settings.check_invariants and entries:
            fault = broken_by(state, [entry.event for entry in entries])
            if fault:
                self._break(fault, [entry.event for entry in entries])
        if entries:
            self._unwritten.extend(entries)
            may_wait = all(isinstance(entry.event, MAY_WAIT) for entry in entries)
            self._writer.submit([entry.record for entry in entries], may_wait=may_wait)
        self._set_alarm()

    def _suspects(self, entries: Sequence[Entry]) -> list[ModuleName]:
        """Modules that may have failed once too often."""
        if not self.settings.quarantine_after:
            return []
        found = {e.event.module: True for e in entries if isinstance(e.event, SUSPICIOUS)}
        return list(found)

    def _grant_access(self, state: LabState, entries: list[Entry]) -> bool:
        """Nothing is left to start: who waits to reach in may, where nothing moves."""
        before = len(entries)
        for cell, access in list(state.lab.access.items()):
            if not access.granted:
                self._decide_too(GrantAccess(cell), entries)
        return len(entries) > before

    def _decide_too(self, command: Command, entries: list[Entry]) -> None:
        decision = decide(self.state, command)
        if isinstance(decision, Rejection):
            # Planning proposes only what the rules allow: a rejection is a fault of ours.
            _log.error("proposal_rejected", command=repr(command), why=decision.message)
            self.faults.append(f"{command!r}: {decision.message}")
            return
        cause = entries[-1].record.head.id if entries else ""
        entries.extend(self._write(decision, "labos", cause))

    def _break(self, fault: str, events: Sequence[Event]) -> None:
        """Refuse a batch that must never be written: the state is folded again without it."""
        names = ", ".join(event.TYPE for event in events)
        error = InvariantBroken(f"Refused to write [{names}]: {fault}.", remedy="This is a fault of LabOS.")
        _log.error("invariant_broken", fault=fault, events=names)
        self.faults.append(str(error))
        self._breaks += 1
        self._lose(error if self._breaks >= BREAKS_BORNE else StoreUnavailable(str(error)))
        raise error

    def _set_alarm(self) -> None:
        deadline = self.scheduler.next_deadline(self.state)
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

    # -- what the writer says ----------------------------------------------------------------

    def _on_durable(self, position: int) -> None:
        self.durable = position
        self._breaks = self._losses = 0
        self._lost_at = None
        entries: list[Entry] = []
        while self._unwritten and self._unwritten[0].position <= position:
            entries.append(self._unwritten.popleft())
        for listener in self.listeners:
            listener.committed(entries)
        while self._waiting and self._waiting[0][0] <= position:
            future = self._waiting.popleft()[1]
            if not future.done():
                future.set_result(None)
        self._keep_snapshot(position)

    def _on_failure(self, error: StoreError) -> None:
        _log.error("commit_failed", error=str(error))
        self._lose(error)

    def _lose(self, error: StoreError | InvariantBroken) -> None:
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
        if isinstance(error, Fenced | InvariantBroken):
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
            except StoreError as again:
                error = self._lost_why = again
                continue
            _log.warning("log_reopened", position=self.durable)
            for listener in self.listeners:
                listener.reopened()
            self.wake()
            return
        self._stop(error)

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
            state, _ = load(store, begin=follower.hand_over() if follower is not None else None)
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
            except StoreError as error:
                # Nothing was decided meanwhile, and nothing could be: an idle lab has lost its log too.
                if self._ledger is not None:
                    _log.error("lease_not_renewed", error=str(error))
                self._lose(error)

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


def in_doubt(error: StoreUnavailable) -> CommitInDoubt:
    """What whoever waits for a commit is told when the store failed in the midst of it."""
    remedy = f"{error.remedy} Look with `labos log` before you ask for the same again.".strip()
    return CommitInDoubt(error.message, remedy=remedy)
