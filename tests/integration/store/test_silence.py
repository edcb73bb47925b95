"""A server that stands still under whoever waits for it, and says neither yes nor no."""

from __future__ import annotations

import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from labos.errors import StoreUnavailable
from labos.store import SqlEventStore, find_first_damage
from tests.integration.store.records import batch, write_records
from tests.support.postgres import PostgresServer

Open = Callable[..., SqlEventStore]
pytestmark = pytest.mark.postgres


class Asked(threading.Thread):
    """Asks a store something that it does not answer."""

    def __init__(self, question: Callable[[], object]) -> None:
        super().__init__(daemon=True)
        self.question = question
        self.error: Exception | None = None
        self.start()

    def run(self) -> None:
        try:
            self.question()
        except Exception as error:
            self.error = error


@contextmanager
def freeze(server: PostgresServer) -> Iterator[None]:
    server.freeze()
    try:
        yield
    finally:
        server.thaw()


@pytest.fixture
def server(own_postgres: Callable[[], PostgresServer]) -> PostgresServer:
    return own_postgres()


@pytest.mark.parametrize("rows", [1, pytest.param(60, marks=pytest.mark.full)], ids=["single rows", "a COPY"])
@pytest.mark.slow
def test_whoever_waits_for_a_frozen_server_can_be_helped_out(
    server: PostgresServer, opened: Open, rows: int
) -> None:
    store = opened(server.create_database("lab"))
    head = write_records(store, 3)
    records = batch(head, rows)
    with freeze(server):
        writing = Asked(lambda: store.append(head, records))
        reading = Asked(lambda: list(store.read()))
        for asked in (writing, reading):
            asked.join(0.3)
            assert asked.is_alive(), "a frozen server answers nobody"
        store.hang_up()
        for asked in (writing, reading):
            asked.join(30)
            assert isinstance(asked.error, StoreUnavailable), asked.error
        # Nobody can say yet what became of it: the next question is answered only when it is sure.
        with pytest.raises(StoreUnavailable):
            store.head()
    truth = store.head()
    assert truth.position in (3, 3 + rows)
    after = store.append(truth, batch(truth))
    assert after.position == truth.position + 1
    assert find_first_damage(store) is None


@pytest.mark.slow
def test_a_store_is_closed_under_whoever_waits_for_it(server: PostgresServer, opened: Open) -> None:
    store = opened(server.create_database("lab"))
    head = write_records(store, 3)
    with freeze(server):
        writing = Asked(lambda: store.append(head, batch(head)))
        writing.join(0.3)
        assert writing.is_alive()
        store.close()
        writing.join(30)
        assert isinstance(writing.error, StoreUnavailable), writing.error


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have no such option")
def test_a_peer_that_vanished_is_given_up_by_the_system(opened: Open, postgres_url: str) -> None:
    store = opened(postgres_url)
    write_records(store, 1)

    def limit(connection: Any) -> int:
        line = connection.connection.driver_connection.pgconn.socket
        with socket.fromfd(line, socket.AF_INET, socket.SOCK_STREAM) as handle:
            return handle.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)

    for engine in (store._backend.reading, store._backend.writing):
        with engine.connect() as connection:
            assert limit(connection) == 10_000
