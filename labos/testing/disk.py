"""Storage in memory that keeps what was synced, and only that, when its process dies."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from labos.core.envelope import GENESIS, Record, damage
from labos.core.ids import LabId
from labos.errors import Fenced, LogDamaged, Refused, StoreError, StoreUnavailable
from labos.ports import EventStore, Head, LogQuery
from labos.testing.faults import Faults
from labos.testing.loop import Process

T = TypeVar("T")


class SimulatedStore:
    """The event store port over a list; outlives kernels."""

    def __init__(self) -> None:
        self.records: list[Record] = []
        self._head = Head(LabId(""), 0, GENESIS, 0)
        self._holder: Process | None = None
        self._snapshot: tuple[int, bytes, str, bytes] | None = None
        self.process: Process | None = None

    def head(self) -> Head:
        return self._head

    def claim(self, lab: LabId, owner: str, lease_s: float) -> Head:
        if self._holder is not None and self._holder.alive and self._holder is not self.process:
            raise Refused(f"The kernel {self._holder.name} holds this lab.")
        self._holder = self.process
        head = self._head
        self._head = Head(head.lab or lab, head.position, head.hash, head.epoch + 1, head.recorded_at)
        return self._head

    def renew(self, epoch: int, lease_s: float) -> None:
        if epoch != self._head.epoch:
            raise Fenced(f"Epoch {epoch} is over.")

    def release(self, epoch: int) -> None:
        if epoch == self._head.epoch:
            self._holder = None

    def append(self, expected: Head, records: Sequence[Record]) -> Head:
        head = self._head
        if (expected.position, expected.hash, expected.epoch) != (head.position, head.hash, head.epoch):
            raise Fenced(f"The log ends at {head.position} of epoch {head.epoch}.")
        previous = head.hash
        for record in records:
            fault = damage(previous, record)
            if fault:
                raise LogDamaged(fault, position=record.head.position)
            previous = record.hash
        self.records.extend(records)
        last = records[-1]
        self._head = Head(head.lab, last.head.position, last.hash, head.epoch, last.head.recorded_at)
        return self._head

    def read(self, after: int = 0, upto: int | None = None) -> Iterator[Record]:
        return iter(self.records[after:upto])

    def select(self, query: LogQuery) -> Iterator[Record]:
        return iter(self.records[query.after : query.upto])

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
    """The kernel's writer in virtual time: commits take a while, die, or fail with an unknown
    outcome."""

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
            batch, self._queue = self._queue, []
            asyncio.get_running_loop().call_later(0.004, self._commit, batch)

    def _commit(self, batch: list[Record]) -> None:
        self._busy = False
        if self._head is None:
            return
        self._faults.at("kernel.before_commit")
        try:
            if self._faults.happens(self._faults.rates.commit_error):
                if self._faults.rng.random() < 0.5:
                    self._store.append(self._head, batch)
                raise StoreUnavailable("The connection broke during the commit.")
            self._head = self._store.append(self._head, batch)
        except StoreError as error:
            self._head = None
            self._queue.clear()
            self._on_failure(error)
            return
        self._faults.at("kernel.after_commit")
        self._on_durable(self._head.position)
        self._next()

    async def call(self, function: Callable[[EventStore], T]) -> T:
        await asyncio.sleep(0.002)
        self._store.process = self._process
        return function(self._store)

    async def close(self) -> None:
        while self._busy or self._queue:
            await asyncio.sleep(0.01)


class SimulatedJournalFile:
    """A node's journal file; a crash may leave a torn last line."""

    def __init__(self, disk: dict[str, bytes], name: str, faults: Faults) -> None:
        self._disk, self._name, self._faults = disk, name, faults

    async def read(self) -> bytes:
        return self._disk.get(self._name, b"")

    async def append(self, data: bytes) -> None:
        await asyncio.sleep(0.002)
        self._faults.at("node.before_journal")
        old = self._disk.get(self._name, b"")
        self._disk[self._name] = old + data[: self._faults.rng.randrange(len(data))]
        self._faults.at("node.torn_journal")
        self._disk[self._name] = old + data
        self._faults.at("node.after_journal")

    async def replace(self, data: bytes) -> None:
        await asyncio.sleep(0.002)
        self._faults.at("node.before_journal")
        self._disk[self._name] = data
        self._faults.at("node.after_journal")

    async def close(self) -> None:
        pass
