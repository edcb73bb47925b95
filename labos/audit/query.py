"""SQL queries on the views. A query can never change anything."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from typing import Any, Protocol

import msgspec

from labos.audit._ddl import VIEW_SCHEMA, Dialect
from labos.audit.database import make_audit_url
from labos.errors import BadInput, StoreUnavailable
from labos.store import TranslatedErrors, display_name, find_sqlite_path

TIME_LIMIT_S = 30.0
FETCHED = 1000
"""The number of rows that are fetched at once."""

_STEPS = 10_000
"""The number of SQLite's steps after which it checks the time limit."""

_SEE = "The views and their columns: labos sql --views"


class QueryResult(msgspec.Struct, frozen=True):
    """Rows come in the order in which they are found; times are text in ISO 8601, UTC."""

    columns: tuple[str, ...]
    rows: Iterator[Sequence[Any]]


class ReadConnection(Protocol):
    """A read-only connection. ``values`` replace each ``?`` in the query, in order; ``named`` ones replace
    ``:name``."""

    @property
    def dialect(self) -> Dialect: ...

    def fetch(self, query: str, *values: Any, **named: Any) -> list[Any]:
        """All rows of an internal query, as tuples, without a time limit."""

    def ask(self, query: str, values: Sequence[Any] = ()) -> QueryResult:
        """Run one query. Raises BadInput if it is not a query, or if it exceeds its time limit."""


@contextmanager
def open_asker(url: str, limit_s: float = TIME_LIMIT_S) -> Iterator[ReadConnection]:
    """Open the views of a log for queries; each query may take ``limit_s`` seconds. Raises StoreUnavailable
    if there are none."""
    parsed = make_audit_url(url)
    if parsed.get_backend_name() == "sqlite":
        path = find_sqlite_path(parsed)
        if not path.exists():
            raise StoreUnavailable(
                f"There is no {display_name(parsed)}.", remedy="Create it: labos audit project"
            )
        with TranslatedErrors(parsed):
            lite = _open_sqlite(path.as_uri())
        with closing(lite):
            yield _SqliteAsker(lite, limit_s)
        return
    from labos.audit._postgres import connect

    with TranslatedErrors(parsed):
        server = connect(parsed)
        server.execute("SET default_transaction_read_only = on")
        server.execute(f"SET search_path = {VIEW_SCHEMA}, pg_catalog".encode())
        server.execute("SET TIME ZONE 'UTC'")
    with closing(server):
        yield _PostgresAsker(server, limit_s)


# -- SQLite ------------------------------------------------------------------------------------

_READS = {
    sqlite3.SQLITE_SELECT,
    sqlite3.SQLITE_READ,
    sqlite3.SQLITE_FUNCTION,
    sqlite3.SQLITE_RECURSIVE,
}


def _open_sqlite(uri: str) -> sqlite3.Connection:
    """A database in memory, to which the file is attached with the name of PostgreSQL's schema of the
    views."""
    connection = sqlite3.connect(":memory:", isolation_level=None, uri=True)
    try:
        connection.execute(f"ATTACH ? AS {VIEW_SCHEMA}", (f"{uri}?mode=ro",))
        connection.execute(f"SELECT 1 FROM {VIEW_SCHEMA}.sqlite_master").fetchone()
        connection.execute("PRAGMA query_only = ON")
    except BaseException:
        connection.close()
        raise
    return connection


def _allow(action: int, first: str | None, second: str | None, *others: str | None) -> int:
    """Allow only reading: no PRAGMA, no ATTACH, no transaction, no writing."""
    if action == sqlite3.SQLITE_FUNCTION and second in ("load_extension", "readfile", "writefile", "edit"):
        return sqlite3.SQLITE_DENY
    return sqlite3.SQLITE_OK if action in _READS else sqlite3.SQLITE_DENY


class _SqliteAsker:
    dialect: Dialect = "sqlite"

    def __init__(self, connection: sqlite3.Connection, limit_s: float) -> None:
        self._connection, self._limit_s = connection, limit_s
        self._is_guarded = False

    def fetch(self, query: str, *values: Any, **named: Any) -> list[Any]:
        if self._is_guarded:  # tables of SQLite's extensions declare themselves, which is no reading
            self._connection.set_authorizer(None)
            self._is_guarded = False
        self._connection.set_progress_handler(None, 0)
        return self._connection.execute(query, named or values).fetchall()

    def ask(self, query: str, values: Sequence[Any] = ()) -> QueryResult:
        end = time.monotonic() + self._limit_s
        self._connection.set_authorizer(_allow)
        self._is_guarded = True
        self._connection.set_progress_handler(lambda: int(time.monotonic() > end), _STEPS)
        try:
            cursor = self._connection.execute(query, values)
        except (sqlite3.Error, sqlite3.Warning) as error:
            raise _make_refusal(str(error), self._limit_s) from None
        if cursor.description is None:
            raise BadInput("This is not a query.", remedy="Write a SELECT statement.")
        return QueryResult(tuple(column[0] for column in cursor.description), self._rows(cursor))

    def _rows(self, cursor: sqlite3.Cursor) -> Iterator[Sequence[Any]]:
        try:
            yield from cursor
        except sqlite3.Error as error:
            raise _make_refusal(str(error), self._limit_s) from None


# -- PostgreSQL --------------------------------------------------------------------------------


class _PostgresAsker:
    """The query is declared as a cursor in a transaction that only reads: both accept only queries, and the
    protocol of prepared statements accepts only one statement."""

    dialect: Dialect = "postgresql"

    def __init__(self, connection: Any, limit_s: float) -> None:
        self._connection, self._limit_s = connection, limit_s

    def fetch(self, query: str, *values: Any, **named: Any) -> list[Any]:
        for name in named:
            query = query.replace(f":{name}", f"%({name})s")
        found = self._connection.execute(query if named else _write_for_postgres(query), named or values)
        return [tuple(_write_moment(value) for value in row) for row in found.fetchall()]

    def ask(self, query: str, values: Sequence[Any] = ()) -> QueryResult:
        rows = self._rows(query, values)
        columns = next(rows)
        return QueryResult(tuple(columns), rows)

    def _rows(self, query: str, values: Sequence[Any]) -> Iterator[Sequence[Any]]:
        import psycopg

        end = time.monotonic() + self._limit_s
        connection = self._connection
        if values:
            query = _write_for_postgres(query)
        connection.execute("BEGIN READ ONLY")
        try:
            self._set_limit(end)
            declared = f"DECLARE labos_answer NO SCROLL CURSOR FOR {query}"
            connection.execute(declared, values or None, prepare=True)
            first = True
            while True:
                self._set_limit(end)
                found = connection.execute(f"FETCH {FETCHED} FROM labos_answer")
                if first:
                    yield [column.name for column in found.description]
                    first = False
                rows = found.fetchall()
                yield from ([_write_moment(value) for value in row] for row in rows)
                if len(rows) < FETCHED:
                    return
        except psycopg.Error as error:
            raise _make_refusal(str(error).partition("\n")[0], self._limit_s) from None
        finally:
            if not connection.closed:
                connection.execute("ROLLBACK")

    def _set_limit(self, end: float) -> None:
        left_ms = max(1, round((end - time.monotonic()) * 1000))
        self._connection.execute(f"SET LOCAL statement_timeout = {left_ms}")


def _write_for_postgres(query: str) -> str:
    return query.replace("%", "%%").replace("?", "%s")


def _write_moment(value: Any) -> Any:
    """A time in the form of SQLite's views."""
    if isinstance(value, datetime):
        return f"{value.astimezone(UTC).replace(tzinfo=None).isoformat(timespec='milliseconds')}Z"
    return value


def _make_refusal(words: str, limit_s: float) -> BadInput:
    if "interrupted" in words or "statement timeout" in words:
        return BadInput(
            f"The query took longer than {limit_s:g} s.",
            remedy="Request less data, or allow more time: labos sql --timeout SECONDS",
        )
    if "not authorized" in words or "read-only" in words or "readonly" in words:
        return BadInput("Only queries are allowed here, and no changes.", remedy="Write a SELECT statement.")
    return BadInput(f"The database refuses this query: {words}.", remedy=_SEE)
