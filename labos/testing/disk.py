"""Storage in memory. When its process dies, only synced data remain."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

from labos.core.envelope import GENESIS, Record, find_damage
from labos.core.erasure import list_erased
from labos.core.ids import LabId
from labos.core.words import Kept
from labos.errors import Fenced, LogDamaged, Refused, StoreError, StoreUnavailable
from labos.ports import EventStore, Head, LogQuery, Row
from labos.testing.faults import Faults
from labos.testing.loop import Process, context_of

T = TypeVar("T")


class SimulatedStore:
    """The event store port over a list, which outlives kernels. ``now`` is the time (s) of the server's
    clock. Data that were written but not synced remain if the kernel dies, and are lost in a power cut of the
    machine.
    """

    def __init__(self, now: Callable[[], float] = lambda: 0.0) -> None:
        self.records: list[Record] = []
        self.words: dict[str, Kept] = {}
        self._now = now
        self._head = Head(LabId(""), 0, GENESIS, 0)
        self._holder: Process | None = None
        self._lease_until = self._renewed_until = 0.0
        self._unsynced: tuple[Process | None, Head, list[Record]] | None = None
        self._snapshot: tuple[int, bytes, str, bytes] | None = None
        self.process: Process | None = None
        """The process that calls."""
        self.dropped = 0
        """Commits that were lost in a power cut before they were on disk."""
        self.usurped: list[str] = []
        """Kernels that were replaced although they were alive, worked and had renewed their lease in time."""

    def head(self) -> Head:
        return self._head

    def claim(self, lab: LabId, owner: str, lease_s: float) -> Head:
        holder = self._holder
        if holder is not None and holder.alive and holder is not self.process:
            if self.now() < self._lease_until:
                raise Refused(f"The kernel {holder.name} holds this lab.")
            if self._now() < self._renewed_until:
                self.usurped.append(holder.name)
        self._settle(holder)
        self._holder = self.process
        self._lease(lease_s)
        head = self._head
        self._head = Head(head.lab or lab, head.position, head.hash, head.epoch + 1, head.recorded_at)
        return self._head

    def now(self) -> float:
        """The time for leases: always the server's."""
        return self._now()

    def is_abandoned(self) -> bool:
        """Whether the kernel is alive, but its lease has expired: a standby then takes over."""
        holder = self._holder
        return holder is not None and holder.alive and self.now() >= self._lease_until

    def renew(self, epoch: int, lease_s: float) -> None:
        if epoch != self._head.epoch:
            raise Fenced(f"Epoch {epoch} is over.")
        self._lease(lease_s)

    def _lease(self, lease_s: float) -> None:
        self._lease_until = self.now() + lease_s
        self._renewed_until = self._now() + lease_s

    def release(self, epoch: int, *, to_standby: bool = False) -> None:
        if epoch == self._head.epoch:
            self._holder = None

    def append(self, expected: Head, records: Sequence[Record]) -> Head:
        self.write(expected, records)
        return self.sync()

    def write(self, expected: Head, records: Sequence[Record]) -> None:
        """Write after position ``expected``; the data are on disk after ``sync``. Raises Fenced,
        LogDamaged."""
        head = self._head
        if (expected.position, expected.hash, expected.epoch) != (head.position, head.hash, head.epoch):
            raise Fenced(f"The log ends at {head.position} of epoch {head.epoch}.")
        previous = head.hash
        for record in records:
            fault = find_damage(previous, record)
            if fault:
                raise LogDamaged(fault, position=record.head.position)
            previous = record.hash
        last = records[-1]
        after = Head(head.lab, last.head.position, last.hash, head.epoch, last.head.recorded_at)
        self._unsynced = (self.process, after, list(records))

    def sync(self) -> Head:
        """Put the written data on disk. Raises Fenced if a successor has ended the transaction."""
        self._check_own()
        return self._keep()

    def give_up(self, *, written: bool) -> None:
        """Simulate a connection that breaks during a commit, whose outcome is then unknown. Raises Fenced."""
        self._check_own()
        if written:
            self._keep()
        self._unsynced = None

    def _check_own(self) -> None:
        if self._unsynced is None or self._unsynced[0] is not self.process:
            raise Fenced("The transaction was ended by another kernel.")

    def _keep(self) -> Head:
        if self._unsynced is not None:
            _, self._head, records = self._unsynced
            self._unsynced = None
            self.records.extend(records)
            for record in records:
                self.words.update((kept.reference, kept) for kept in record.words)
                for name in list_erased(record.head.type, record.head.schema, record.payload):
                    self.words[name] = Kept(name, b"", "")
        return self._head

    def _settle(self, holder: Process | None) -> None:
        """Settle the last write of the previous kernel: if it is dead, the system's cache remains unless the
        power was cut; if it is alive, its transaction is ended."""
        if self._unsynced is None or holder is None:
            return
        if holder.alive or holder.powerless:
            self.dropped += holder.powerless
            self._unsynced = None
        else:
            self._keep()

    def read(self, after: int = 0, upto: int | None = None) -> Iterator[Record]:
        return iter(self.records[after:upto])

    def replay(
        self, after: int = 0, upto: int | None = None, *, before: bytes = b"", end: Head | None = None
    ) -> Iterator[Row]:
        for record in self.read(after, upto):
            head = record.head
            yield head.position, head.type, head.schema, head.recorded_at, record.payload

    def select(self, query: LogQuery) -> Iterator[Record]:
        records = self.records[query.after : query.upto]
        return (record for record in records if not query.types or record.head.type in query.types)

    def words_of(self, references: Iterable[str]) -> dict[str, Kept]:
        return {name: self.words[name] for name in references if name in self.words}

    def scrub(self) -> str:
        return ""

    def save_snapshot(self, position: int, hash_: bytes, fingerprint: str, data: bytes) -> None:
        self._snapshot = (position, hash_, fingerprint, data)

    def load_snapshot(self, fingerprint: str) -> tuple[int, bytes, bytes] | None:
        found = self._snapshot
        if found is None or found[2] != fingerprint or self.records[found[0] - 1].hash != found[1]:
            return None
        return found[0], found[1], found[3]

    def close(self) -> None:
        pass


class SimulatedWriter:
    """The kernel's writer in virtual time: commits take time, may fail with an unknown outcome, and may be
    interrupted by the end of the process."""

    def __init__(self, store: SimulatedStore, faults: Faults, process: Process) -> None:
        self._store, self._faults, self._process = store, faults, process
        self._queue: list[Record] = []
        self._head: Head | None = None
        self._busy = False
        self._on_durable: Callable[[int], None] = lambda _: None
        self._on_failure: Callable[[StoreError], None] = lambda _: None

    def begin(
        self, head: Head, on_durable: Callable[[int], None], on_failure: Callable[[StoreError], None]
    ) -> None:
        self._head, self._on_durable, self._on_failure = head, on_durable, on_failure
        self._queue.clear()

    def submit(self, records: Sequence[Record]) -> None:
        if self._head is None:
            return
        self._queue.extend(records)
        self._next()

    def _next(self) -> None:
        if self._queue and not self._busy and self._head is not None:
            self._busy = True
            self._schedule(0.002, self._write, self._head)

    def _schedule(self, after_s: float, step: Callable[..., None], *args: Any) -> None:
        """Call ``step`` in the kernel's own context after a time, also if another process asked for the
        write."""
        asyncio.get_running_loop().call_later(after_s, step, *args, context=context_of(self._process))

    def _write(self, head: Head) -> None:
        """Take the waiting batches and pass them to the system."""
        batch, self._queue = self._queue, []
        if not self._is_current(head) or not batch:
            self._go_on()
            return
        self._faults.visit("kernel.before_commit")
        if self._process.frozen:
            self._queue = batch
            self._schedule(0.0, self._write, head)
            return
        self._store.process = self._process
        try:
            self._store.write(head, batch)
        except StoreError as error:
            self._fail(error)
            return
        self._faults.visit("kernel.unsynced_commit")
        self._schedule(0.002, self._sync, head)

    def _sync(self, head: Head) -> None:
        if not self._is_current(head):
            self._go_on()
            return
        self._store.process = self._process
        try:
            if self._faults.strikes("commit_error"):
                self._store.give_up(written=self._faults.rng.random() < 0.5)
                raise StoreUnavailable("The connection broke during the commit.")
            self._head = self._store.sync()
        except StoreError as error:
            self._fail(error)
            return
        self._faults.visit("kernel.after_commit")
        self._on_durable(self._head.position)
        self._go_on()

    def _go_on(self) -> None:
        self._busy = False
        self._next()

    def _is_current(self, head: Head) -> bool:
        """Whether the kernel has not been opened again meanwhile."""
        return self._head == head

    def _fail(self, error: StoreError) -> None:
        self._head, self._busy = None, False
        self._queue.clear()
        self._on_failure(error)

    async def call(self, function: Callable[[EventStore], T]) -> T:
        await asyncio.sleep(0.002)
        while self._busy:
            await asyncio.sleep(0.001)
        self._store.process = self._process
        return function(self._store)

    async def close(self) -> None:
        while self._busy or self._queue:
            await asyncio.sleep(0.01)


class SimulatedJournalFile:
    """A node's journal file. If its process dies during a write, the last line may be torn. If the power
    fails, any part of the data that were not synced may be lost."""

    def __init__(self, disk: dict[str, bytes], name: str, faults: Faults, process: Process) -> None:
        self._disk, self._name, self._faults = disk, name, faults
        self._synced = disk.get(name, b"")
        self._process = process
        process.on_death.append(self._lose_unsynced)

    async def read(self) -> bytes:
        return self._disk.get(self._name, b"")

    async def append(self, data: bytes) -> None:
        await asyncio.sleep(0.001)
        await self._faults.pass_point("node.before_journal")
        old = self._synced
        self._disk[self._name] = old + data[: self._faults.rng.randrange(len(data))]
        self._faults.visit("node.torn_journal")
        self._disk[self._name] = old + data
        await self._sync()

    async def replace(self, data: bytes) -> None:
        await asyncio.sleep(0.001)
        await self._faults.pass_point("node.before_journal")
        self._disk[self._name] = data
        await self._sync()

    async def _sync(self) -> None:
        await self._faults.pass_point("node.unsynced_journal")
        await asyncio.sleep(0.001)
        self._synced = self._disk[self._name]
        await self._faults.pass_point("node.after_journal")

    def _lose_unsynced(self) -> None:
        written = self._disk.get(self._name, b"")
        if self._process.powerless and written != self._synced:
            if written.startswith(self._synced):
                left = self._faults.rng.randrange(len(self._synced), len(written) + 1)
                self._disk[self._name] = written[:left]
                self._faults.torn += left < len(written)
            else:
                self._disk[self._name] = self._synced

    async def close(self) -> None:
        pass
