"""Where the rows are kept: beside a log in SQLite in a file of their own, of one in PostgreSQL in schemas of
their own.

So the projector never takes the lock with which the kernel writes to a SQLite file, and on PostgreSQL a role
may be allowed to read the views and nothing else.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, ClassVar

import msgspec
from sqlalchemy.engine import URL

from labos.audit._ddl import Dialect, drop_all, make_all
from labos.audit._encode import encode_rows, encode_values
from labos.audit._rows import Key, Row, RowChanges
from labos.audit.tables import VERSION, Table
from labos.errors import LogTooNew
from labos.store import TranslatedErrors, display_name, parse_url, sqlite_path


class Mark(msgspec.Struct, frozen=True):
    """Up to where a log is in the tables: position and hash of its last record there."""

    lab: str = ""
    position: int = 0
    hash: str = ""
    at_s: float | None = None


class AuditDatabase(ABC):
    """Calls block. All raise StoreUnavailable. What is abstract is where SQLite and PostgreSQL differ."""

    dialect: ClassVar[Dialect]

    def __init__(self, url: URL) -> None:
        self.name, self._url, self._door = display_name(url), url, TranslatedErrors(url)

    def prepare(self) -> Mark:
        """Make the tables if there are none; those of an older version are thrown away first. Raises
        LogTooNew for those of a newer one."""
        with self._write_transaction():
            if not is_current(self._version(), self._url):
                self._make_anew()
            return self._mark()

    @property
    def is_made(self) -> bool:
        """Whether there are tables."""
        with self._door:
            return self._version() > 0

    def mark(self) -> Mark:
        """Up to where the log is in the tables."""
        with self._door:
            return self._mark()

    def reset(self) -> None:
        """Throw everything away and make empty tables."""
        with self._write_transaction():
            self._make_anew()

    def forget(self) -> str:
        """Throw everything away, so that nothing of it stands in the database's files, and make empty tables.
        Returns why something still may stand there; empty if it does not."""
        self.reset()
        with self._door:
            return self._scrub()

    @abstractmethod
    def _scrub(self) -> str:
        """Nothing of rows that were thrown away stands in the files any more, or why it may."""

    @abstractmethod
    def load(self, table: Table, key: Key) -> Row | None:
        """A row, or None."""

    def write(self, before: Mark, after: Mark, rows: RowChanges) -> bool:
        """Write what is new and changed, all or nothing; False if the tables are not at ``before``."""
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

    @abstractmethod
    def close(self) -> None: ...

    # -- inside ------------------------------------------------------------------------------

    def _make_anew(self) -> None:
        for statement in (*drop_all(self.dialect), *make_all(self.dialect)):
            self._execute(statement)
        self._note(Mark())

    def _lock_mark(self) -> Mark:
        """The mark, which nobody else changes before this transaction ends."""
        return self._mark()

    @abstractmethod
    def _write_transaction(self) -> AbstractContextManager[None]:
        """A transaction that writes."""

    @abstractmethod
    def _execute(self, statement: str) -> object: ...

    @abstractmethod
    def _version(self) -> int:
        """Of the tables; 0 if there are none."""

    @abstractmethod
    def _mark(self) -> Mark: ...

    @abstractmethod
    def _note(self, mark: Mark) -> None: ...

    @abstractmethod
    def _insert(self, table: Table, rows: Iterable[Sequence[Any]]) -> None:
        """Rows whose keys are new."""

    @abstractmethod
    def _replace(self, table: Table, rows: list[Sequence[Any]]) -> None:
        """Rows that are new or take the place of others."""


def audit_file(log: Path) -> Path:
    """The file that stands beside a log's file: ``labos-audit.db`` beside ``labos.db``."""
    return log.with_name(f"{log.stem}-audit.db")


def audit_url(url: str) -> URL:
    """The database of the tables for the URL of a log. Raises BadInput."""
    parsed = parse_url(url)
    if parsed.get_backend_name() != "sqlite":
        return parsed
    return parsed.set(database=str(audit_file(sqlite_path(parsed))))


def open_audit(url: str) -> AuditDatabase:
    """The tables that stand beside a log, for writing. Raises BadInput, StoreUnavailable."""
    parsed = audit_url(url)
    if parsed.get_backend_name() == "sqlite":
        from labos.audit._sqlite import SqliteAudit

        return SqliteAudit(parsed)
    from labos.audit._postgres import PostgresAudit

    return PostgresAudit(parsed)


def is_current(found: int, url: URL) -> bool:
    """Whether tables of a version are ours. Raises LogTooNew if they are of a newer LabOS."""
    if found > VERSION:
        raise LogTooNew(
            f"The audit tables of the {display_name(url)} were made by a newer LabOS.",
            remedy="Use that one, or make them anew with this one: labos audit rebuild",
        )
    return found == VERSION
