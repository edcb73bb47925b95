"""A log that is followed in an event loop: what is read of it is true, new, and of one log."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator, Sequence
from pathlib import Path

import msgspec
import pytest

from labos.clock import SystemClock, Uuid7Ids
from labos.core.decide.cancelling import CancelRun
from labos.core.envelope import Record
from labos.core.ids import RunId
from labos.core.state import hash_state
from labos.errors import LogDamaged, Refused, StoreUnavailable
from labos.runtime import followed
from labos.runtime.followed import Behind, FollowedKernel, SendOn
from labos.runtime.ledger import Entry
from labos.runtime.marks import Marks
from labos.store import SqlEventStore, open_store
from tests.integration.runtime.test_follower import go_on
from tests.unit.services.logbook import Logbook, save


class Heard:
    def __init__(self) -> None:
        self.positions: list[int] = []
        self.reopenings = 0

    def on_committed(self, entries: Sequence[Entry]) -> None:
        self.positions += [entry.position for entry in entries]

    def on_reopened(self) -> None:
        self.reopenings += 1


@pytest.fixture
def book() -> Logbook:
    made = Logbook()
    made.furnish()
    made.submit("pcr")
    return made


@pytest.fixture
def store(book: Logbook, tmp_path: Path) -> Iterator[SqlEventStore]:
    opened = open_store(save(book.records, tmp_path / "lab"))
    yield opened
    opened.close()


def follow(store: SqlEventStore, what: Callable[[FollowedKernel, Heard], Awaitable[None]]) -> None:
    async def main() -> None:
        kernel, heard = FollowedKernel(store, SystemClock(), Uuid7Ids()), Heard()
        kernel.listeners.append(heard)
        await kernel.open()
        kernel.follow()
        try:
            await what(kernel, heard)
        finally:
            await kernel.close()

    asyncio.run(main())


def test_who_asks_sees_what_was_on_disk_before(book: Logbook, store: SqlEventStore) -> None:
    async def look(kernel: FollowedKernel, heard: Heard) -> None:
        before = kernel.durable
        assert before == len(book.records)
        await asyncio.to_thread(go_on, book, store)
        await kernel.wait_until_known()
        assert hash_state(kernel.state) == hash_state(book.state)
        assert heard.positions == list(range(before + 1, len(book.records) + 1))
        assert kernel.epoch == book.state.lab.epoch

    follow(store, look)


def test_who_waits_for_a_position_gets_it_or_hears_why_not(
    book: Logbook, store: SqlEventStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def look(kernel: FollowedKernel, heard: Heard) -> None:
        wanted = kernel.durable + 1
        waiting = asyncio.ensure_future(kernel.wait_until_known(wanted))
        await kernel.wait_until_known()
        assert not waiting.done()
        await asyncio.to_thread(go_on, book, store)
        await waiting
        assert kernel.durable >= wanted
        monkeypatch.setattr(followed, "BEHIND_S", 0.01)
        with pytest.raises(Behind, match=f"up to position {kernel.durable}, not yet up to 10000"):
            await kernel.wait_until_known(10_000)

    follow(store, look)


def test_a_command_is_judged_and_never_carried_out(book: Logbook, store: SqlEventStore) -> None:
    async def look(kernel: FollowedKernel, heard: Heard) -> None:
        before = hash_state(kernel.state)
        with pytest.raises(Refused):
            await kernel.execute(CancelRun(RunId("R99")), "ada")
        with pytest.raises(SendOn):
            await kernel.execute(CancelRun(RunId("R1")), "ada")
        assert hash_state(kernel.state) == before
        assert heard.positions == []

    follow(store, look)


def test_a_log_that_was_put_back_is_read_anew(book: Logbook, store: SqlEventStore, tmp_path: Path) -> None:
    other = Logbook()
    other.furnish()
    for _ in range(3):
        other.submit("cp_newplate")
    put_back = open_store(save(other.records, tmp_path / "other"))

    async def look(kernel: FollowedKernel, heard: Heard) -> None:
        kernel._store = put_back
        await kernel.wait_until_known()
        assert hash_state(kernel.state) == hash_state(other.state)
        assert heard.reopenings == 1
        kernel._store = store  # and one that is shorter
        await kernel.wait_until_known()
        assert kernel.durable == len(book.records)

    try:
        follow(store, look)
    finally:
        put_back.close()


@pytest.mark.parametrize("changed", ["payload", "actor"])
def test_a_record_that_was_changed_is_not_folded(
    book: Logbook, store: SqlEventStore, monkeypatch: pytest.MonkeyPatch, changed: str
) -> None:
    def read(after: int = 0, upto: int | None = None) -> Iterator[Record]:
        for record in found(after, upto):
            if record.head.position == bad and changed == "payload":
                yield msgspec.structs.replace(record, payload=record.payload.replace(b"{", b"{ ", 1))
            elif record.head.position == bad:
                head = msgspec.structs.replace(record.head, actor="mallory")
                yield msgspec.structs.replace(record, head=head)
            else:
                yield record

    async def look(kernel: FollowedKernel, heard: Heard) -> None:
        await asyncio.to_thread(go_on, book, store)
        with pytest.raises(LogDamaged) as raised:
            await kernel.wait_until_known()
        assert raised.value.position == bad
        assert heard.positions == []
        monkeypatch.undo()
        await kernel.wait_until_known()
        assert kernel.durable == len(book.records)

    found, bad = store.read, len(book.records) + 2
    monkeypatch.setattr(store, "read", read)
    follow(store, look)


def test_nobody_waits_for_ever_for_a_log_that_is_away(
    book: Logbook, store: SqlEventStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def look(kernel: FollowedKernel, heard: Heard) -> None:
        def away() -> None:
            raise StoreUnavailable("The disk is gone.")

        monkeypatch.setattr(store, "head", away)
        with pytest.raises(StoreUnavailable, match="The disk is gone"):
            await kernel.wait_until_known()
        assert kernel.durable == len(book.records), "what is known is still told"
        monkeypatch.undo()
        await kernel.wait_until_known()

    follow(store, look)


def test_marks_are_found_whoever_wrote_them() -> None:
    class MarkedLog:
        found: list[tuple[int, str]] = [(3, "request:a"), (7, "request:b"), (9, "request:a")]
        fails = False

        def list_caused_by(self, prefix: str, last: int) -> list[tuple[int, str]]:
            if self.fails:
                raise StoreUnavailable("The disk is gone.")
            return self.found

    async def main() -> None:
        log = MarkedLog()
        marks = Marks(log)
        marks.begin()
        assert [await marks.find(f"request:{name}") for name in "abc"] == [3, 7, 0]
        log.found = [(12, "request:c")]
        marks.on_reopened()
        assert [await marks.find(f"request:{name}") for name in "abc"] == [3, 7, 12]
        log.fails = True
        marks.on_reopened()
        for _ in range(2):  # what is not known is not guessed
            with pytest.raises(StoreUnavailable):
                await marks.find("request:d")
        await marks.close()

    asyncio.run(main())
