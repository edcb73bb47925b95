"""The storage of the rows: for a log in SQLite in a separate file, for a log in PostgreSQL in separate
schemas. So the projector never needs the lock with which the kernel writes to a SQLite file, and on
PostgreSQL a role can be allowed to read only the views.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from operator import itemgetter
from pathlib import Path
from typing import Any, ClassVar

import msgspec
from sqlalchemy.engine import URL

from labos.audit._ddl import STATE, Dialect, drop_all, make_all, table_name, write_select
from labos.audit._rows import Key, Row, RowChanges
from labos.audit.tables import TABLES, VERSION, Table
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
        self._selects = {table.name: write_select(table, self.dialect) for table in TABLES}
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
            found = self._execute(self._selects[table.name], key).fetchone()
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
    def _execute(self, statement: str, values: Sequence[Any] = ()) -> Any:
        """A cursor with the answer; ``values`` replace each ``?``."""

    @abstractmethod
    def _has_state(self) -> bool:
        """Whether the table of the state exists."""

    def _note(self, mark: Mark) -> None:
        self._execute(
            f"INSERT INTO {self._state} VALUES (1, ?, ?, ?, ?, ?) ON CONFLICT (id) DO UPDATE SET "
            "version = excluded.version, lab = excluded.lab, position = excluded.position, "
            "hash = excluded.hash, at_s = excluded.at_s",
            (VERSION, mark.lab, mark.position, mark.hash, mark.at_s),
        )

    @abstractmethod
    def _insert(self, table: Table, rows: Iterable[Sequence[Any]]) -> None:
        """Insert rows with new keys."""

    @abstractmethod
    def _replace(self, table: Table, rows: list[Sequence[Any]]) -> None:
        """Insert or replace rows."""


_NUL, _SHOWN = "\0", "\N{SYMBOL FOR NULL}"
_encode = msgspec.json.Encoder(order="sorted").encode

_JSON = {
    table.name: [at for at, column in enumerate(table.columns) if column.kind == "json"] for table in TABLES
}
_IN_ORDER: dict[str, Callable[[Row], tuple[Any, ...]]] = {
    table.name: itemgetter(*table.stored) for table in TABLES
}


def encode_rows(table: Table, rows: Iterable[Row], *, nul: bool) -> list[Sequence[Any]]:
    """Rows in the form for the database; see ``encode_values``."""
    in_order = _IN_ORDER[table.name]
    return encode_values(table, [in_order(row) for row in rows], nul=nul)


def encode_values(table: Table, rows: list[Key], *, nul: bool) -> list[Sequence[Any]]:
    """The same for rows with values in the order of their columns. PostgreSQL cannot store a NUL character:
    it is replaced by the symbol for NUL."""
    at = _JSON[table.name]
    made: list[Sequence[Any]] = list(rows)
    if at:
        made = [_with_json(values, at) for values in rows]
    return [[_show(value) for value in values] for values in made] if nul else made


def decode_row(table: Table, values: Any) -> Row:
    """A row from the database."""
    found = list(values)
    for at in _JSON[table.name]:
        found[at] = None if found[at] is None else msgspec.json.decode(found[at])
    return dict(zip(table.stored, found, strict=True))


def _with_json(values: Key, at: list[int]) -> list[Any]:
    made = list(values)
    for number in at:
        value = made[number]
        made[number] = None if value is None else _encode(value).decode()
    return made


def _show(value: Any) -> Any:
    return value.replace(_NUL, _SHOWN).replace("\\u0000", _SHOWN) if isinstance(value, str) else value


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
