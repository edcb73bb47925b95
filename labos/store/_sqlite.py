"""SQLite: one file, WAL, and a lock file that makes one process the kernel."""

from __future__ import annotations

import os
import socket
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import structlog
from sqlalchemy import (
    BigInteger,
    ColumnElement,
    Connection,
    Engine,
    create_engine,
    event,
    func,
    literal,
    literal_column,
)
from sqlalchemy.engine import URL
from sqlalchemy.pool import NullPool, QueuePool

from labos.errors import Refused, StoreUnavailable
from labos.lockfile import FileLock
from labos.ports import Head, Row
from labos.private import make_database_file
from labos.store._backend import (
    ERASE_WORDS,
    INSERT_WORDS,
    MOVE_HEAD,
    Backend,
    WordChanges,
    make_head_row,
)
from labos.store._url import find_sqlite_path

BUSY_TIMEOUT_S = 5.0
"""How long to wait for another program that writes to the same file (seconds)."""

_log = structlog.get_logger(__name__)

_INSERT = "INSERT INTO event VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"


class SqliteBackend(Backend):
    """The backend for SQLite. The file lock alone decides who is the kernel: it is released with its process,
    so a restart need not wait. Nobody can be a standby."""

    now_ms: ColumnElement[int] = literal_column(
        "CAST((julianday('now') - 2440587.5) * 86400000 AS INTEGER)", BigInteger
    )

    def __init__(self, url: URL) -> None:
        self.path = find_sqlite_path(url)
        self.writing = make_writing_engine(self.path)
        self.reading = make_reading_engine(self.path)
        self._lock = FileLock(self.path.with_name(self.path.name + ".kernel.lock"))

    def occupy(self, owner: str) -> None:
        process = f"pid {os.getpid()} on {socket.gethostname()}"
        if not self._lock.acquire(f"{process if owner in ('', process) else f'{process} ({owner})'}\n"):
            holder = self._lock.note() or "unknown"
            raise Refused(
                f"Another kernel already runs the lab in {self.path}: {holder}.",
                remedy="Stop it first, or give this one a database of its own.",
            )

    def vacate(self) -> None:
        if self._lock.is_held:
            try:
                self._move_into_the_file()
            finally:
                self._lock.release()

    def is_locked(self, connection: Connection, epoch: int) -> bool:
        return self._lock.is_taken()

    def append(
        self, connection: Connection, expected: Head, after: Head, rows: Sequence[Row], beside: WordChanges
    ) -> bool:
        driver: Any = connection.connection.driver_connection
        driver.execute("BEGIN IMMEDIATE")
        try:
            moved: bool = driver.execute(MOVE_HEAD, make_head_row(expected, after)).rowcount == 1
            if moved:
                _insert(driver, rows, beside)
            driver.execute("COMMIT" if moved else "ROLLBACK")
        except BaseException:
            # Some errors, such as a full disk, have rolled it back already.
            if driver.in_transaction:
                driver.execute("ROLLBACK")
            raise
        return moved

    def insert(self, connection: Connection, rows: Sequence[Row], beside: WordChanges) -> None:
        _insert(connection.connection.driver_connection, rows, beside)

    def scrub(self) -> str:
        # Erased data is overwritten (secure_delete), but older pages may be in the write-ahead log until it
        # is moved into the file and truncated.
        return self._move_into_the_file()

    def fetch(self, statement: str, parameters: Sequence[object]) -> list[Row]:
        with closing(self.reading.raw_connection()) as pooled, closing(pooled.cursor()) as cursor:
            cursor.execute(statement, parameters)
            return cursor.fetchall()  # type: ignore[return-value]

    def contains(self, column: ColumnElement[Any], part: str | bytes) -> ColumnElement[bool]:
        return func.instr(column, literal(part)) > 0

    def flaw(self, connection: Connection) -> str:
        (found,) = connection.exec_driver_sql("PRAGMA integrity_check(1)").first() or ("ok",)
        return "" if found == "ok" else str(found)

    def close(self) -> None:
        # Close the readers first. SQLite moves its write-ahead log into the file and removes it when the last
        # connection is closed, but only if this connection may write.
        self.reading.dispose()
        self.vacate()
        self.writing.dispose()

    def _move_into_the_file(self) -> str:
        """After an orderly end, the single file contains the whole log, even if others still have it open.
        Returns why it does not."""
        try:
            # An engine of LabOS is not used here: it would create the file again if a person has moved it
            # away.
            with closing(_open(self.path, "rw")) as connection:
                connection.execute("PRAGMA checkpoint_fullfsync = ON")
                busy, *_ = connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
        except sqlite3.Error as error:
            why = str(error)
        else:
            why = "another program reads it" if busy else ""
        if why:
            _log.warning("log_not_in_one_file", file=str(self.path), why=why)
        return why


def _insert(driver: Any, rows: Sequence[Row], beside: WordChanges) -> None:
    if rows:
        driver.executemany(_INSERT, rows)
    if beside.added:
        driver.executemany(INSERT_WORDS, beside.added)
    if beside.erased:
        driver.executemany(ERASE_WORDS, beside.erased)


def make_writing_engine(path: Path) -> Engine:
    """Connections that write to a file, each for one use; a transaction is exclusive from its begin."""

    def connect() -> sqlite3.Connection:
        # Only the lab may read the log: SQLite's side files get the permissions of the main file.
        make_database_file(path)
        # isolation_level None: otherwise sqlite3 would begin its own transactions, which are deferred.
        connection = sqlite3.connect(
            path, timeout=BUSY_TIMEOUT_S, isolation_level=None, check_same_thread=False
        )
        try:
            connection.execute("PRAGMA synchronous = FULL")
            # Erased or moved data is overwritten.
            connection.execute("PRAGMA secure_delete = ON")
            # macOS: without this setting, fsync leaves data in the drive's cache; other systems ignore it.
            connection.execute("PRAGMA fullfsync = ON")
            connection.execute("PRAGMA checkpoint_fullfsync = ON")
            (mode,) = connection.execute("PRAGMA journal_mode = WAL").fetchone()
            if mode != "wal":
                raise StoreUnavailable(
                    f"The folder of {path} cannot hold a write-ahead log (journal mode {mode}).",
                    remedy="Put the database on a local disk.",
                )
        except BaseException:
            connection.close()
            raise
        return connection

    engine = create_engine("sqlite+pysqlite://", creator=connect, poolclass=NullPool)

    @event.listens_for(engine, "begin")
    def begin_immediately(connection: Connection) -> None:
        connection.exec_driver_sql("BEGIN IMMEDIATE")

    return engine


def make_reading_engine(path: Path) -> Engine:
    """Connections that cannot write; the writer never waits for them."""

    def connect() -> sqlite3.Connection:
        connection = _open(path, "ro")
        try:
            connection.execute("PRAGMA schema_version").fetchone()
        except sqlite3.OperationalError:
            connection.close()
            wal = path.with_name(path.name + "-wal")
            if os.access(path.parent, os.W_OK) or (wal.exists() and wal.stat().st_size):
                raise
            # The database is in a folder without write permission: SQLite cannot make its side files there
            # and needs none.
            return _open(path, "ro&immutable=1")
        return connection

    engine = create_engine(
        "sqlite+pysqlite://", creator=connect, poolclass=QueuePool, pool_size=4, max_overflow=60
    )

    @event.listens_for(engine, "begin")
    def begin_reading(connection: Connection) -> None:
        connection.exec_driver_sql("BEGIN")

    return engine


def _open(path: Path, mode: str) -> sqlite3.Connection:
    """A connection to an existing file: in these modes SQLite does not create one."""
    return sqlite3.connect(
        f"{path.as_uri()}?mode={mode}",
        uri=True,
        timeout=BUSY_TIMEOUT_S,
        isolation_level=None,
        check_same_thread=False,
    )
