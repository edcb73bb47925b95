"""What may wait for the next batch does, and nothing waits longer than somebody waits for it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

from labos.clock import SystemClock, Uuid7Ids
from labos.core.envelope import Record
from labos.core.ids import LabId
from labos.core.lab import KernelStarted
from labos.core.state import LabState
from labos.errors import StoreError
from labos.runtime.ledger import Ledger
from labos.runtime.writer import PatientWriter, ThreadWriter
from labos.store import open_store

AGES = 3600.0


class Log:
    """A log on disk behind a patient writer; notes what each commit reached."""

    def __init__(self, folder: Path, hold_s: float) -> None:
        self.store = open_store(f"sqlite:///{folder}/labos.db")
        head = self.store.claim(LabId("lab"), "test", 60.0)
        self.ledger = Ledger(LabState(), head, SystemClock(), Uuid7Ids())
        self.writer = PatientWriter(ThreadWriter(self.store), hold_s=hold_s)
        self.commits: list[int] = []
        self.failures: list[StoreError] = []
        self.changed = asyncio.Event()
        self.writer.begin(head, self._on_durable, self.failures.append)

    def records(self) -> list[Record]:
        """One event more."""
        event = KernelStarted(self.ledger.head.position + 1, "test")
        return [self.ledger.write(event, "test").record]

    def _on_durable(self, position: int) -> None:
        self.commits.append(position)
        self.changed.set()

    async def until(self, position: int) -> None:
        while not self.commits or self.commits[-1] < position:
            self.changed.clear()
            await self.changed.wait()


def run(folder: Path, scenario: Callable[[Log], Awaitable[None]], hold_s: float = AGES) -> None:
    async def main() -> None:
        log = Log(folder, hold_s)
        try:
            await scenario(log)
            assert not log.failures
        finally:
            await log.writer.close()
            log.store.close()

    asyncio.run(main())


def test_a_batch_that_may_wait_goes_with_the_next(tmp_path: Path) -> None:
    async def scenario(log: Log) -> None:
        log.writer.submit(log.records(), may_wait=True)
        log.writer.submit(log.records(), may_wait=True)
        log.writer.submit(log.records())
        await log.until(3)
        assert log.commits == [3]

    run(tmp_path, scenario)


def test_a_batch_that_may_wait_goes_alone_in_the_end(tmp_path: Path) -> None:
    async def scenario(log: Log) -> None:
        log.writer.submit(log.records(), may_wait=True)
        await log.until(1)
        log.writer.submit(log.records(), may_wait=True)
        await log.until(2)
        assert log.commits == [1, 2]

    run(tmp_path, scenario, hold_s=0.001)


def test_whoever_waits_sends_it_off(tmp_path: Path) -> None:
    async def scenario(log: Log) -> None:
        log.writer.submit(log.records(), may_wait=True)
        log.writer.flush()
        await log.until(1)
        log.writer.flush()
        assert log.commits == [1]

    run(tmp_path, scenario)


def test_the_store_is_read_behind_all_that_was_submitted(tmp_path: Path) -> None:
    async def scenario(log: Log) -> None:
        log.writer.submit(log.records(), may_wait=True)
        assert await log.writer.call(lambda store: store.head().position) == 1

    run(tmp_path, scenario)


def test_nothing_is_left_behind_at_the_end(tmp_path: Path) -> None:
    async def scenario(log: Log) -> None:
        log.writer.submit(log.records(), may_wait=True)
        await log.writer.close()
        assert log.store.head().position == 1

    run(tmp_path, scenario)
