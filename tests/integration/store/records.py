"""Sealed records, and raw access to a database, for the tests of the store."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator, MutableMapping
from contextlib import closing, contextmanager
from typing import Any

import structlog
from structlog.testing import capture_logs

from labos.clock import Uuid7Ids
from labos.core.canonical import digest, encode_canonical
from labos.core.envelope import Envelope, Record, seal
from labos.core.ids import LabId
from labos.ports import Head
from labos.store import SqlEventStore

LAB = LabId("lab-1")
START_NS = 1_700_000_000_000_000_000
LEASE_S = 30.0

_ids = Uuid7Ids()


def batch(after: Head, n: int = 1, payload: dict[str, Any] | None = None, **fields: Any) -> list[Record]:
    """``n`` records behind a head; by default each in a stream of its own."""
    records: list[Record] = []
    previous = after.hash
    for position in range(after.position + 1, after.position + n + 1):
        body = encode_canonical(payload if payload is not None else {"n": position})
        values: dict[str, Any] = {
            "id": _ids.new(),
            "stream": f"run:{position}",
            "version": 1,
            "type": "run.started",
            "schema": 1,
            "recorded_at": START_NS + position,
            "actor": "user:1",
            "correlation": "",
            "causation": "",
        }
        head = Envelope(lab=after.lab, position=position, digest=digest(body), **(values | fields))
        record = seal(previous, head, body)
        previous = record.hash
        records.append(record)
    return records


def write_records(store: SqlEventStore, n: int) -> Head:
    """Claim the lab and write ``n`` records."""
    head = store.claim(LAB, "test", LEASE_S)
    return store.append(head, batch(head, n))


@contextmanager
def hear_journal() -> Iterator[list[MutableMapping[str, Any]]]:
    """What the program says in its journal inside the block; tests are silent otherwise."""
    before = structlog.get_config()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(0))
    try:
        with capture_logs() as told:
            yield told
    finally:
        structlog.configure(**before)


class Raw:
    """A connection past the store: every statement is committed at once."""

    def __init__(self, connection: Any, is_sqlite: bool) -> None:
        self._connection = connection
        self.is_sqlite = is_sqlite

    def run(self, statement: str, *parameters: object) -> list[tuple[Any, ...]]:
        marks = statement if self.is_sqlite else statement.replace("?", "%s")
        cursor = self._connection.execute(marks, parameters)
        return list(cursor.fetchall()) if cursor.description else []

    def disarm(self) -> None:
        """Drop the triggers, as somebody who tampers would."""
        tables = {"event": ("insert", "update", "delete"), "head": ("update", "delete")}
        for table, kinds in tables.items():
            for kind in kinds:
                on = "" if self.is_sqlite else f" ON {table}"
                self.run(f"DROP TRIGGER {table}_{kind}{on}")


@contextmanager
def raw(url: str) -> Iterator[Raw]:
    """Direct access to a store's database."""
    if url.startswith("sqlite:///"):
        path = url.removeprefix("sqlite:///")
        with closing(sqlite3.connect(path, isolation_level=None, timeout=5)) as connection:
            yield Raw(connection, is_sqlite=True)
    else:
        import psycopg

        with psycopg.connect(url, autocommit=True) as server:
            yield Raw(server, is_sqlite=False)


Tamper = Callable[[Raw], object]


def flip(column: str, position: int, byte: int = 0) -> Tamper:
    """Flips a bit of a record's column of bytes."""

    def turn(database: Raw) -> None:
        ((value,),) = database.run(f"SELECT {column} FROM event WHERE position = ?", position)
        changed = bytearray(value)
        changed[byte] ^= 1
        database.run(f"UPDATE event SET {column} = ? WHERE position = ?", bytes(changed), position)

    return turn
