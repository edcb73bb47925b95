"""A database that says nothing: the writer gives it up, and begins anew when it speaks again."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from labos.clock import SystemClock, Uuid7Ids
from labos.core.ids import LabId
from labos.core.lab import KernelStarted
from labos.errors import StoreError, StoreUnavailable
from labos.runtime.ledger import Ledger, load
from labos.runtime.silence import SilenceTimer
from labos.runtime.writer import ThreadWriter
from labos.store import SqlEventStore, open_store
from tests.support.postgres import PostgresServer


def silent(limit_s: float, sign: Callable[[], object | None], looks: int) -> int:
    """How often somebody was called silent, within so many looks at ``sign``."""

    async def main() -> int:
        called, looked, over = [], [], asyncio.Event()

        def observe() -> object | None:
            looked.append(sign())
            if len(looked) >= looks or looked[-1] is None:
                over.set()
            return looked[-1]

        silence = SilenceTimer(limit_s, observe, lambda: called.append(1))
        silence.watch()
        silence.watch()
        await over.wait()
        silence.stop()
        return len(called)

    return asyncio.run(main())


def test_the_same_sign_for_too_long_is_silence_again_and_again() -> None:
    assert silent(0.05, lambda: "hung", looks=60) >= 2


def test_whoever_answers_now_and_then_is_not_silent() -> None:
    signs = iter(range(100))
    assert silent(0.05, lambda: next(signs), looks=60) == 0


def test_nobody_looks_where_nothing_was_asked() -> None:
    assert silent(0.05, lambda: None, looks=60) == 0


class Told:
    """What a writer tells a kernel."""

    def __init__(self, store: SqlEventStore, silence_s: float) -> None:
        self.store = store
        self.writer = ThreadWriter(store, silence_s=silence_s)
        self.commits: list[int] = []
        self.failures: list[StoreError] = []
        self.news = asyncio.Event()

    def begin(self) -> Ledger:
        head = self.store.head()
        self.writer.begin(head, self._durable, self._note_failure)
        state, _ = load(self.store)
        return Ledger(state, head, SystemClock(), Uuid7Ids())

    def _durable(self, position: int) -> None:
        self.commits.append(position)
        self.news.set()

    def _note_failure(self, error: StoreError) -> None:
        self.failures.append(error)
        self.news.set()

    async def hears(self) -> None:
        await self.news.wait()
        self.news.clear()

    def submit(self, ledger: Ledger) -> None:
        event = KernelStarted(ledger.head.position + 1, "test")
        self.writer.submit([ledger.write(event, "test").record])


def run(server: PostgresServer, scenario: Callable[[Told], Awaitable[None]]) -> None:
    store = open_store(server.create_database("lab"))

    async def main() -> None:
        store.claim(LabId("lab"), "test", 60.0)
        await scenario(Told(store, 1.0))

    try:
        asyncio.run(main())
    finally:
        server.thaw()
        store.close()


@pytest.mark.postgres
def test_a_silent_database_is_given_up_once_and_nothing_of_it_comes_late(
    own_postgres: Callable[[], PostgresServer],
) -> None:
    server = own_postgres()

    async def scenario(told: Told) -> None:
        ledger = told.begin()
        told.submit(ledger)
        await told.hears()
        server.freeze()
        told.submit(ledger)
        behind = asyncio.create_task(told.writer.call(lambda store: store.head()))
        await told.hears()
        with pytest.raises(StoreUnavailable, match=r"PostgreSQL .* has not answered for 1 s"):
            await behind
        told.submit(ledger)  # by somebody who has not heard yet: dropped
        with pytest.raises(StoreUnavailable):
            await told.writer.call(lambda store: store.head())
        assert (told.commits, len(told.failures)) == ([1], 1)
        server.thaw()
        head = await told.writer.call(lambda store: store.head())
        assert head.position in (1, 2)
        told.submit(told.begin())
        await told.hears()
        assert told.commits == [1, head.position + 1]
        assert len(told.failures) == 1
        await told.writer.close()

    run(server, scenario)


@pytest.mark.slow
@pytest.mark.postgres
def test_a_writer_is_closed_although_its_database_is_silent(
    own_postgres: Callable[[], PostgresServer],
) -> None:
    server = own_postgres()

    async def scenario(told: Told) -> None:
        ledger = told.begin()
        server.freeze()
        told.submit(ledger)
        await told.writer.close()
        assert told.commits == []
        assert len(told.failures) == 1

    run(server, scenario)
