"""The log as the kernel uses it: events are decided ahead of the disk, the log is read again after a failed
write, and the lease is given back at the end."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol

import msgspec
import structlog

from labos.clock import Clock, Ids
from labos.core.actions import ActionRequested
from labos.core.ids import ActionId, LabId
from labos.core.lab import KernelStarted
from labos.core.registry import Event, decode
from labos.core.state import LabState
from labos.errors import Fenced, LabosError, StoreError, StoreUnavailable
from labos.ports import EventStore, LogQuery
from labos.runtime.follower import Follower
from labos.runtime.ledger import Entry, Ledger, load, snapshot
from labos.runtime.writer import PatientWriter, Writer, make_in_doubt_error, settle

LONGEST_PAUSE_S = 5.0
"""The pause between two attempts to reach the store again."""

_log = structlog.get_logger(__name__)


class Listener(Protocol):
    """Receives events once they are on disk, in order. A class that derives from it need not do anything when
    the log was read again."""

    def on_committed(self, entries: Sequence[Entry]) -> None: ...

    def on_reopened(self) -> None:
        """The log was read again: events that were decided but not written are forgotten."""
        return


class OnEvents(Listener):
    """Calls a function for each committed event of these kinds."""

    def __init__(self, kinds: tuple[type[Event], ...], call: Callable[[Any], object]) -> None:
        self._kinds, self._call = kinds, call

    def on_committed(self, entries: Sequence[Entry]) -> None:
        for entry in entries:
            if isinstance(entry.event, self._kinds):
                self._call(entry.event)


class KernelSettings(msgspec.Struct, frozen=True):
    """``lease_s`` is how long a kernel that does not answer keeps its lease; ``snapshot_every`` counts
    events; ``reopen_s`` is how long the kernel tries to reach its store again before it stops (0: not at all;
    infinity: without end). A module that fails ``quarantine_after`` times (0: however often) within
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


class KernelLog(ABC):
    """The base of the kernel, without its turns."""

    def __init__(self, writer: Writer, clock: Clock, ids: Ids, settings: KernelSettings) -> None:
        self.settings = settings
        self.clock, self.ids = clock, ids
        self.listeners: list[Listener] = []
        self.failed: asyncio.Future[LabosError] = asyncio.get_running_loop().create_future()
        self.durable = 0
        self.faults: deque[str] = deque(maxlen=100)
        """The kernel's own faults that it had to undo or refuse: failed turns, proposals against the rules,
        failed listeners. Only the latest ones; ``fault_count`` counts all."""
        self.fault_count = 0
        self._refolding: asyncio.Task[None] | None = None
        self._writer = PatientWriter(writer)
        self._ledger: Ledger | None = None
        self._unwritten: deque[Entry] = deque()
        self._waiting: deque[tuple[int, asyncio.Future[None]]] = deque()
        self._tasks: list[asyncio.Task[None]] = []
        self._snapshot_at = 0
        self._saving: asyncio.Task[None] | None = None  # asyncio itself keeps no reference
        self._picture: tuple[int, bytes, str, bytes] | None = None
        self._closing = False
        self._to_standby = False
        self._lost_at: float | None = None
        self._lost_why: LabosError | None = None
        self._losses = 0
        self._epoch_claimed: int | None = None
        self._follower: Follower | None = None

    @abstractmethod
    def wake(self) -> None:
        """The log was read again: check everything that waits."""

    @abstractmethod
    def _forget(self) -> None:
        """The log is read again: forget everything that was derived from the earlier state."""

    @property
    def state(self) -> LabState:
        """The speculative state: everything decided so far. Callers read it and never change it."""
        return self._open_ledger().state

    @property
    def lab(self) -> LabId:
        return self._open_ledger().head.lab

    @property
    def epoch(self) -> int:
        return self._open_ledger().head.epoch

    async def flush(self) -> None:
        """Wait until everything decided so far is on disk. Raises StoreError if it is lost."""
        ledger = self._open_ledger()
        if self.durable >= ledger.head.position:
            return
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.append((ledger.head.position, future))
        self._writer.flush()
        await future

    async def list_starts(self) -> list[tuple[int, int]]:
        """The epochs of this log's kernels, and the positions where they began. Raises StoreError."""

        def look(store: EventStore) -> list[tuple[int, int]]:
            found = store.select(LogQuery(types=(KernelStarted.TYPE,)))
            pairs = [(decode(r.head.type, r.head.schema, r.payload), r.head.position) for r in found]
            return [(event.epoch, at) for event, at in pairs if isinstance(event, KernelStarted)]

        return await self._writer.call(look)

    async def holds_request(self, action: ActionId, position: int) -> bool:
        """Whether the record at a position of the log is a request of this action. Raises StoreError."""
        if not 0 < position <= self.durable:
            return False

        def look(store: EventStore) -> bool:
            records = store.read(position - 1, position)
            events = [decode(r.head.type, r.head.schema, r.payload) for r in records]
            return any(isinstance(e, ActionRequested) and e.action == action for e in events)

        return await self._writer.call(look)

    async def scrub(self) -> str:
        """Remove what remains of erased words from the database's files. Returns why something may still
        remain; empty if nothing does."""
        try:
            return await self._writer.call(lambda store: store.scrub())
        except StoreError as error:
            return error.message

    async def check_lease(self) -> None:
        """Ask the database whether this is still the lab's kernel; if it is not, the kernel stops. Raises
        Fenced then, StoreError if the database does not answer."""
        epoch, lease = self.epoch, self.settings.lease_s
        try:
            await self._writer.call(lambda store: store.renew(epoch, lease))
        except Fenced as error:
            self._lose(error)
            raise

    async def leave_to_standby(self) -> None:
        """Close, and let a standby take over at once; from then on nothing is decided here."""
        self._to_standby = True
        await self.close()
        self._lose(
            Fenced(
                "This kernel has handed its lab over to a standby.",
                remedy="Try again: the standby answers soon.",
            )
        )

    async def close(self) -> None:
        """Write all decided events, store a snapshot, give the lease back. ``failed`` has the error if the
        last events could not be written."""
        if self._closing:
            return
        self._closing = True
        if self._refolding is not None:
            await asyncio.wait({self._refolding}, timeout=LONGEST_PAUSE_S)
        for task in self._tasks:
            task.cancel()
        if self._epoch_claimed is not None and not self.failed.done():
            try:
                await self.flush()
            except StoreError as error:
                self._stop(self._lost_why or error)
            else:
                await self._leave()
        await self._writer.close()

    async def _leave(self) -> None:
        ledger = self._open_ledger()
        picture, epoch, to_standby = snapshot(ledger.state, ledger.head), ledger.head.epoch, self._to_standby
        try:
            if not to_standby:  # a standby has folded the log itself
                await self._writer.call(lambda store: store.save_snapshot(*picture))
            await self._writer.call(lambda store: store.release(epoch, to_standby=to_standby))
        except StoreError as error:
            _log.warning("lease_not_given_back", why=str(error))

    def _take_back(self, why: str) -> None:
        """Undo the events that were folded in this turn. The writer already has earlier turns: the log is
        read again after them."""
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
            await self._reopen(_make_store_error(error))
        else:
            self._refolding = None  # the next lines may fail again
            self._go_on()

    # -- called by the writer ----------------------------------------------------------------

    def _on_durable(self, position: int) -> None:
        self.durable = position
        self._losses = 0
        self._lost_at = None
        entries: list[Entry] = []
        while self._unwritten and self._unwritten[0].position <= position:
            entries.append(self._unwritten.popleft())
        for listener in self.listeners:
            if not self._notify(listener, partial(listener.on_committed, entries)):
                self._notify(listener, listener.on_reopened)  # it looks at everything again
        while self._waiting and self._waiting[0][0] <= position:
            settle(self._waiting.popleft()[1], None)
        self._keep_snapshot(position)

    def _on_failure(self, error: StoreError) -> None:
        _log.error("commit_failed", error=str(error))
        self._lose(error)

    def _lose(self, error: StoreError) -> None:
        """Forget everything that is not certainly on disk; then read the log again, unless the kernel is
        closing. Further errors during this time have the same cause."""
        reopening, self._ledger = self._ledger is None, None
        self._lost_why = error
        self._unwritten.clear()
        self._picture = None
        failure = make_in_doubt_error(error) if type(error) is StoreUnavailable else error
        waiting, self._waiting = self._waiting, deque()
        for _, future in waiting:
            settle(future, None, failure)
        if self._closing:
            return
        if isinstance(error, Fenced):
            self._stop(error)
        elif not reopening:
            self._tasks.append(asyncio.get_running_loop().create_task(self._reopen(error)))

    async def _reopen(self, error: LabosError) -> None:
        """Open the log again after a commit in doubt. A database that can be read but not written (a full
        disk) does not count as available: the renewal of its lease tests this."""
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
                error = self._lost_why = _make_store_error(again)
                continue
            self._go_on()
            return
        self._stop(error)

    def _go_on(self) -> None:
        """The log was read again."""
        _log.warning("log_reopened", position=self.durable)
        for listener in self.listeners:
            self._notify(listener, listener.on_reopened)
        self.wake()

    def _notify(self, listener: Listener, call: Callable[[], None]) -> bool:
        """Call a listener. If it fails, the others are still called."""
        try:
            call()
        except StoreError as error:
            _log.info("listener_waits_for_log", listener=type(listener).__name__, why=str(error))
        except Exception as error:
            _log.exception("listener_failed", listener=type(listener).__name__)
            self._record_fault(f"{type(listener).__name__}: {error!r}")
            return False
        return True

    def _record_fault(self, what: str) -> None:
        self.faults.append(what)
        self.fault_count += 1

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
                    remedy="This kernel must stop.",
                )
            follower, self._follower = self._follower, None
            state, _ = load(store, begin=follower.hand_over() if follower is not None else None, end=head)
            return head, state

        head, state = await self._writer.call(read)
        if state.position != head.position:
            raise StoreUnavailable(
                f"The log ends at {head.position}, but records up to {state.position} were read."
            )
        self._epoch_claimed = head.epoch
        self._ledger = Ledger(state, head, self.clock, self.ids)
        self.durable = head.position
        self._forget()
        self._snapshot_at = head.position
        self._writer.begin(head, self._on_durable, self._on_failure)

    def _keep_snapshot(self, position: int) -> None:
        ledger = self._ledger
        if ledger is None:
            return
        if self._picture is not None and position >= self._picture[0]:
            picture, self._picture = self._picture, None
            self._saving = asyncio.get_running_loop().create_task(self._save_snapshot(picture))
        if ledger.head.position - self._snapshot_at >= self.settings.snapshot_every:
            self._snapshot_at = ledger.head.position
            self._picture = snapshot(ledger.state, ledger.head)

    async def _save_snapshot(self, picture: tuple[int, bytes, str, bytes]) -> None:
        try:
            await self._writer.call(lambda store: store.save_snapshot(*picture))
        except StoreError as error:
            _log.warning("snapshot_not_saved", error=str(error))

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
                # Nothing was decided meanwhile, and nothing could be: an idle lab must also notice that its
                # log is lost.
                if self._ledger is not None:
                    _log.error("lease_not_renewed", error=str(error))
                self._lose(_make_store_error(error))

    def _open_ledger(self) -> Ledger:
        if self._ledger is None:
            why = self._lost_why
            if why is None:
                raise StoreUnavailable("The log is still being read.", remedy="Try again in a moment.")
            raise StoreUnavailable(why.message, remedy=why.remedy)
        return self._ledger


def _make_store_error(error: Exception) -> StoreError:
    if isinstance(error, StoreError):
        return error
    _log.error("log_not_read", exc_info=error)
    return StoreUnavailable(f"The log could not be read: {error!r}.", remedy="This is a fault of LabOS.")
