"""The storage of the rows: for a log in SQLite in a separate file, for a log in PostgreSQL in separate
schemas. So the projector never needs the lock with which the kernel writes to a SQLite file, and on
PostgreSQL a role can be allowed to read only the views.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, ClassVar

import msgspec
from sqlalchemy.engine import URL

from labos.audit._ddl import STATE, Dialect, drop_all, make_all, table_name
from labos.audit._encode import decode_row, encode_rows, encode_values
from labos.audit._rows import Key, Row, RowChanges
from labos.audit.tables import VERSION, Table
from labos.errors import LogTooNew
from labos.store import TranslatedErrors, display_name, find_sqlite_path, parse_url


class Mark(msgspec.Struct, frozen=True):
    """The progress of the projection: position and hash of the last record in the tables."""

    lab: str = ""
    position: int = 0
    hash: str = ""
    at_s: float | None = None


class AuditDatabase(ABC):
    """Calls block. All raise StoreUnavailable. The abstract methods are the differences between SQLite and
    PostgreSQL."""

    dialect: ClassVar[Dialect]
    _connection: Any

    def __init__(self, url: URL) -> None:
        self._state = table_name(STATE, self.dialect)
        self.name, self._url, self._door = display_name(url), url, TranslatedErrors(url)

    def prepare(self) -> Mark:
        """Create the tables if there are none; tables of an older version are deleted first. Raises LogTooNew
        for tables of a newer version."""
        with self._write_transaction():
            if not is_current(self._version(), self._url):
                self._recreate()
            return self._mark()

    @property
    def is_made(self) -> bool:
        """Whether the tables exist."""
        with self._door:
            return self._version() > 0

    def mark(self) -> Mark:
        """The progress of the projection."""
        with self._door:
            return self._mark()

    def reset(self) -> None:
        """Delete everything and create empty tables."""
        with self._write_transaction():
            self._recreate()

    def forget(self) -> str:
        """Delete everything, also from the database's files, and create empty tables. Returns the reason if
        data may remain in the files; empty if not."""
        self.reset()
        with self._door:
            return self._scrub()

    @abstractmethod
    def _scrub(self) -> str:
        """Remove deleted rows from the files; returns the reason if data may remain."""

    def load(self, table: Table, key: Key) -> Row | None:
        """A row, or None."""
        with self._door:
            found = self._fetch(table, key)
        return None if found is None else decode_row(table, found)

    def write(self, before: Mark, after: Mark, rows: RowChanges) -> bool:
        """Write new and changed rows, all or none; False if the tables are not at ``before``."""
        with self._write_transaction():
            if self._lock_mark() != before:
                return False
            nul = rows.may_have_nul
            for table, added in rows.list_added():
                self._insert(table, encode_values(table, added, nul=nul))
            for table, changed in rows.list_changed():
                self._replace(table, encode_rows(table, changed, nul=nul))
            self._note(after)
        return True

    def close(self) -> None:
        self._connection.close()

    # -- internal ----------------------------------------------------------------------------

    def _recreate(self) -> None:
        for statement in (*drop_all(self.dialect), *make_all(self.dialect)):
            self._execute(statement)
        self._note(Mark())

    def _lock_mark(self) -> Mark:
        """The mark, locked against changes until this transaction ends."""
        return self._mark()

    @abstractmethod
    def _write_transaction(self) -> AbstractContextManager[None]:
        """A transaction that writes."""

    def _version(self) -> int:
        """The version of the tables; 0 if there are none."""
        found = self._execute(f"SELECT version FROM {self._state}").fetchone() if self._has_state() else None
        return 0 if found is None else int(found[0])

    def _mark(self) -> Mark:
        return Mark(*self._execute(f"SELECT lab, position, hash, at_s FROM {self._state}").fetchone())

    @abstractmethod
    def _execute(self, statement: str) -> Any:
        """A cursor with the answer."""

    @abstractmethod
    def _has_state(self) -> bool:
        """Whether the table of the state exists."""

    @abstractmethod
    def _fetch(self, table: Table, key: Key) -> Any:
        """The values of a row, or None."""

    @abstractmethod
    def _note(self, mark: Mark) -> None: ...

    @abstractmethod
    def _insert(self, table: Table, rows: Iterable[Sequence[Any]]) -> None:
        """Insert rows with new keys."""

    @abstractmethod
    def _replace(self, table: Table, rows: list[Sequence[Any]]) -> None:
        """Insert or replace rows."""


def find_audit_file(log: Path) -> Path:
    """The file beside a log's file: ``labos-audit.db`` beside ``labos.db``."""
    return log.with_name(f"{log.stem}-audit.db")


def make_audit_url(url: str) -> URL:
    """The database of the tables for the URL of a log. Raises BadInput."""
    parsed = parse_url(url)
    if parsed.get_backend_name() != "sqlite":
        return parsed
    return parsed.set(database=str(find_audit_file(find_sqlite_path(parsed))))


def open_audit(url: str) -> AuditDatabase:
    """Open the tables of a log for writing. Raises BadInput, StoreUnavailable."""
    parsed = make_audit_url(url)
    if parsed.get_backend_name() == "sqlite":
        from labos.audit._sqlite import SqliteAudit

        return SqliteAudit(parsed)
    from labos.audit._postgres import PostgresAudit

    return PostgresAudit(parsed)


def is_current(found: int, url: URL) -> bool:
    """Whether tables of a version are of the present version. Raises LogTooNew if they are of a newer
    LabOS."""
    if found > VERSION:
        raise LogTooNew(
            f"The audit tables of the {display_name(url)} were written by a newer LabOS.",
            remedy="Use the newer LabOS, or build the tables again with this one: labos audit rebuild",
        )
    return found == VERSION
