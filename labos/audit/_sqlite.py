"""The tables in a separate SQLite file."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from operator import itemgetter
from typing import Any, ClassVar

from sqlalchemy.engine import URL

from labos.audit._ddl import Dialect, table_name
from labos.audit.database import AuditDatabase
from labos.audit.tables import TABLES, Table
from labos.private import make_database_file
from labos.store import find_sqlite_path

BUSY_TIMEOUT_S = 30.0
"""How long to wait for another projector."""

CACHE_KB = 64_000

PAGES_LOGGED = 20_000
"""The number of pages in the write-ahead log before it is moved into the file; in between, the same pages are
written repeatedly."""


def _insert(table: Table) -> str:
    marks = ", ".join("?" * len(table.stored))
    return f"INSERT OR REPLACE INTO {table_name(table.name, 'sqlite')} VALUES ({marks})"


_INSERT = {table.name: _insert(table) for table in TABLES}


class SqliteAudit(AuditDatabase):
    """See ``AuditDatabase``."""

    dialect: ClassVar[Dialect] = "sqlite"
    _connection: sqlite3.Connection

    def __init__(self, url: URL) -> None:
        super().__init__(url)
        self.path = find_sqlite_path(url)
        self._open()

    def _open(self) -> None:
        with self._door:
            make_database_file(self.path)
            self._connection = sqlite3.connect(
                self.path, timeout=BUSY_TIMEOUT_S, isolation_level=None, check_same_thread=False
            )
            try:
                self._connection.execute("PRAGMA journal_mode = WAL")
                # Rows that a power cut removes are projected again: position and rows are written together.
                self._connection.execute("PRAGMA synchronous = NORMAL")
                # A row that is replaced is also removed from the word index.
                self._connection.execute("PRAGMA recursive_triggers = ON")
                self._connection.execute(f"PRAGMA cache_size = -{CACHE_KB}")
                self._connection.execute(f"PRAGMA wal_autocheckpoint = {PAGES_LOGGED}")
            except sqlite3.DatabaseError:
                self._connection.close()
                raise

    # -- internal ----------------------------------------------------------------------------

    @contextmanager
    def _write_transaction(self) -> Iterator[None]:
        with self._door:
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise

    def _execute(self, statement: str, values: Sequence[Any] = ()) -> sqlite3.Cursor:
        return self._connection.execute(statement, values)

    def _scrub(self) -> str:
        # The file is written anew without its free pages; then the write-ahead log is moved into it and
        # truncated to zero.
        self._connection.execute("VACUUM")
        busy, *_ = self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
        return f"another program reads {self.path}" if busy else ""

    def _has_state(self) -> bool:
        query = "SELECT 1 FROM sqlite_master WHERE name = ?"
        return self._execute(query, (self._state.strip('"'),)).fetchone() is not None

    def _insert(self, table: Table, rows: Iterable[Sequence[Any]]) -> None:
        self._connection.executemany(_INSERT[table.name], rows)

    def _replace(self, table: Table, rows: list[Sequence[Any]]) -> None:
        # The word index is written in the order of the rows' numbers, or in parts.
        self._insert(table, sorted(rows, key=itemgetter(0)) if table.searched else rows)
