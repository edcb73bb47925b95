"""A real PostgreSQL server for the integration tests, started once and only if one is asked for."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator

import pytest

from tests.support.postgres import PostgresServer, find_binaries

_numbers = itertools.count(1)


def new_server() -> PostgresServer:
    """A server, not started; skips the test on a machine that has none."""
    if find_binaries() is None:
        reason = "no PostgreSQL server on this machine (install the package postgresql)"
        if os.environ.get("LABOS_REQUIRE_POSTGRES") == "1":
            pytest.fail(f"LABOS_REQUIRE_POSTGRES is set, but there is {reason}")
        pytest.skip(reason)
    return PostgresServer()


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[PostgresServer]:
    """One server for the whole session; do not stop it, other tests need it."""
    server = new_server()
    try:
        server.start()
        yield server
    finally:
        server.remove()


@pytest.fixture
def postgres_url(postgres_server: PostgresServer) -> str:
    """An empty database of this test's own."""
    return postgres_server.create_database(f"lab_{next(_numbers)}")


@pytest.fixture
def own_postgres() -> Iterator[Callable[[], PostgresServer]]:
    """Starts a server that the test may stop and kill."""
    servers: list[PostgresServer] = []

    def start() -> PostgresServer:
        server = new_server()
        servers.append(server)
        server.start()
        return server

    try:
        yield start
    finally:
        for server in servers:
            server.remove()
