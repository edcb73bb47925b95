"""The tables in schemas of a PostgreSQL database."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, ClassVar

import psycopg
from psycopg import sql
from sqlalchemy.engine import URL

from labos.audit._ddl import STATE, TABLE_SCHEMA, VIEW_SCHEMA, Dialect, table_name
from labos.audit.database import AuditDatabase, Mark
from labos.audit.tables import Table
from labos.errors import NotFound

CONNECT_TIMEOUT_S = 5

_MAKING = 0x4C614175
"""An advisory lock ("LaAu"), so that only one process at a time creates the tables."""


def connect(url: URL) -> psycopg.Connection[Any]:
    """A connection to the log's server. Raises psycopg.Error."""
    plain = url.set(drivername="postgresql").render_as_string(hide_password=False)
    connection = psycopg.connect(
        plain, autocommit=True, connect_timeout=CONNECT_TIMEOUT_S, application_name="labos-audit"
    )
    # JSON stays text, unchanged.
    for kind in ("json", "jsonb"):
        connection.adapters.register_loader(kind, psycopg.types.string.TextLoader)
    return connection


class PostgresAudit(AuditDatabase):
    """See ``AuditDatabase``."""

    dialect: ClassVar[Dialect] = "postgresql"
    _connection: psycopg.Connection[Any]

    def __init__(self, url: URL) -> None:
        super().__init__(url)
        with self._door:
            self._connection = connect(url)

    def allow_reading(self, role: str) -> None:
        """Allow an existing role to read the views, and to find them without the schema's name. Raises
        NotFound, StoreUnavailable."""
        with self._write_transaction():
            if not self._execute("SELECT 1 FROM pg_roles WHERE rolname = ?", (role,)).fetchone():
                raise NotFound(
                    f"The {self.name} has no role {role!r}.",
                    remedy="Create it first: CREATE ROLE name LOGIN PASSWORD '…'",
                )
            name, views = sql.Identifier(role), sql.Identifier(VIEW_SCHEMA)
            self._connection.execute(sql.SQL("GRANT USAGE ON SCHEMA {} TO {}").format(views, name))
            self._connection.execute(
                sql.SQL("GRANT SELECT ON ALL TABLES IN SCHEMA {} TO {}").format(views, name)
            )
            # For views that a later version adds, or creates again.
            self._connection.execute(
                sql.SQL("ALTER DEFAULT PRIVILEGES IN SCHEMA {} GRANT SELECT ON TABLES TO {}").format(
                    views, name
                )
            )

    # -- internal ----------------------------------------------------------------------------

    @contextmanager
    def _write_transaction(self) -> Iterator[None]:
        with self._door, self._connection.transaction():
            self._execute(f"SELECT pg_advisory_xact_lock({_MAKING})")
            yield

    def _execute(self, statement: str, values: Sequence[Any] = ()) -> psycopg.Cursor[Any]:
        if values:
            return self._connection.execute(statement.replace("?", "%s").encode(), values)
        return self._connection.execute(statement.encode())

    def _lock_mark(self) -> Mark:
        self._execute(f"SELECT 1 FROM {self._state} FOR UPDATE")
        return self._mark()

    def _scrub(self) -> str:
        return ""  # the files of tables that are dropped are removed

    def _has_state(self) -> bool:
        return self._execute("SELECT to_regclass(?)", (f"{TABLE_SCHEMA}.{STATE}",)).fetchone() != (None,)

    def _insert(self, table: Table, rows: Iterable[Sequence[Any]]) -> None:
        self._copy(table_name(table.name, "postgresql"), rows)

    def _copy(self, into: str, rows: Iterable[Sequence[Any]]) -> None:
        with self._connection.cursor() as cursor, cursor.copy(f"COPY {into} FROM STDIN".encode()) as copy:
            for row in rows:
                copy.write_row(row)

    def _replace(self, table: Table, rows: list[Sequence[Any]]) -> None:
        """Replace rows by means of a temporary table."""
        stage, into = f'"stage_{table.name}"', table_name(table.name, "postgresql")
        self._execute(f"CREATE TEMP TABLE IF NOT EXISTS {stage} (LIKE {into}) ON COMMIT DROP")
        self._copy(stage, rows)
        key = ", ".join(f'"{name}"' for name in table.key)
        others = [name for name in table.stored if name not in table.key]
        values = ", ".join(f'"{name}" = excluded."{name}"' for name in others)
        self._execute(f"INSERT INTO {into} SELECT * FROM {stage} ON CONFLICT ({key}) DO UPDATE SET {values}")
