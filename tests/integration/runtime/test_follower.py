"""Keeping step with a log that another writes, and handing over what was folded."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.clock import SystemClock, Uuid7Ids
from labos.core.state import LabState, hash_state
from labos.runtime.follower import Follower
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import KernelSettings
from labos.runtime.ledger import load
from labos.runtime.writer import ThreadWriter
from labos.store import SqlEventStore, open_store
from tests.unit.services.logbook import Logbook, save


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


def go_on(book: Logbook, store: SqlEventStore) -> None:
    """Some more happens, in the name of another kernel."""
    before = len(book.records)
    book.at(10)
    book.carry_through("R1", seconds=5, steps=2)
    head = store.claim(store.head().lab, "another", 30.0)
    store.append(head, book.records[before:])


def test_it_folds_what_is_new_and_nothing_again(book: Logbook, store: SqlEventStore) -> None:
    follower = Follower(store)
    assert follower.catch_up() == len(book.records)
    assert follower.catch_up() == 0
    before = len(book.records)
    go_on(book, store)
    assert follower.catch_up() == len(book.records) - before
    assert hash_state(follower.state) == hash_state(book.state)


def test_an_empty_log_is_followed_from_its_first_event_on(book: Logbook, tmp_path: Path) -> None:
    empty = open_store(f"sqlite:///{tmp_path}/new.db")
    try:
        follower = Follower(empty)
        assert follower.catch_up() == 0
        head = empty.claim(book.ledger.head.lab, "another", 30.0)
        assert follower.hand_over() is None, "there is nothing to hand over"
        empty.append(head, book.records)
        assert follower.catch_up() == len(book.records)
    finally:
        empty.close()


def test_a_log_that_was_put_back_is_read_from_its_beginning(
    book: Logbook, store: SqlEventStore, tmp_path: Path
) -> None:
    other = Logbook()
    other.furnish()
    other.submit("cp_newplate")
    other.submit("pcr")
    other.submit("pcr")
    put_back = open_store(save(other.records, tmp_path / "other"))
    try:
        for catches_up in (True, False):
            follower = Follower(store)
            follower.catch_up()
            follower._store = put_back
            if catches_up:
                assert follower.catch_up() == len(other.records)
                assert hash_state(follower.state) == hash_state(other.state)
            else:
                assert follower.hand_over() is None
    finally:
        put_back.close()


def test_a_kernel_folds_on_from_what_it_is_handed(book: Logbook, store: SqlEventStore) -> None:
    follower = Follower(store)
    follower.catch_up()
    handed = follower.state
    go_on(book, store)

    async def main() -> LabState:
        store.release(store.head().epoch)
        kernel = Kernel(ThreadWriter(store), SystemClock(), Uuid7Ids(), KernelSettings())
        await kernel.open(follower)
        state = kernel.state
        await kernel.close()
        return state

    state = asyncio.run(main())
    assert state is handed, "nothing was folded twice"
    assert follower.state.position == 0, "it begins anew"
    assert hash_state(load(store, snapshots=False)[0]) == hash_state(state)
