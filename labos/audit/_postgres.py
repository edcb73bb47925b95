"""The tables in schemas of a PostgreSQL database."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, ClassVar

import psycopg
from psycopg import sql
from sqlalchemy.engine import URL

from labos.audit._ddl import STATE, TABLE_SCHEMA, VIEW_SCHEMA, Dialect, table_name
from labos.audit._encode import decode_row
from labos.audit._rows import Key, Row
from labos.audit.database import AuditDatabase, Mark
from labos.audit.tables import VERSION, Table
from labos.errors import NotFound

CONNECT_TIMEOUT_S = 5

_STATE = table_name(STATE, "postgresql")
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

    def __init__(self, url: URL) -> None:
        super().__init__(url)
        with self._door:
            self._connection = connect(url)

    def load(self, table: Table, key: Key) -> Row | None:
        columns = ", ".join(f'"{name}"' for name in table.stored)
        where = " AND ".join(f'"{name}" = %s' for name in table.key)
        statement = f"SELECT {columns} FROM {table_name(table.name, 'postgresql')} WHERE {where}"
        with self._door:
            found = self._connection.execute(statement.encode(), key).fetchone()
        return None if found is None else decode_row(table, found)

    def close(self) -> None:
        self._connection.close()

    def allow_reading(self, role: str) -> None:
        """Allow an existing role to read the views, and to find them without the schema's name. Raises
        NotFound, StoreUnavailable."""
        with self._write_transaction():
            if not self._execute("SELECT 1 FROM pg_roles WHERE rolname = %s", (role,)).fetchone():
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

    def _execute(self, statement: str, values: Sequence[Any] | None = None) -> psycopg.Cursor[Any]:
        return self._connection.execute(statement.encode(), values)

    def _lock_mark(self) -> Mark:
        self._execute(f"SELECT 1 FROM {_STATE} FOR UPDATE")
        return self._mark()

    def _scrub(self) -> str:
        return ""  # the files of tables that are dropped are removed

    def _version(self) -> int:
        known = self._execute("SELECT to_regclass(%s)", (f"{TABLE_SCHEMA}.{STATE}",)).fetchone()
        if known is None or known[0] is None:
            return 0
        found = self._execute(f"SELECT version FROM {_STATE}").fetchone()
        return 0 if found is None else int(found[0])

    def _mark(self) -> Mark:
        row = self._execute(f"SELECT lab, position, hash, at_s FROM {_STATE}").fetchone()
        assert row is not None
        return Mark(*row)

    def _note(self, mark: Mark) -> None:
        self._execute(
            f"INSERT INTO {_STATE} VALUES (1, %s, %s, %s, %s, %s) ON CONFLICT (id) DO UPDATE SET "
            "version = excluded.version, lab = excluded.lab, position = excluded.position, "
            "hash = excluded.hash, at_s = excluded.at_s",
            (VERSION, mark.lab, mark.position, mark.hash, mark.at_s),
        )

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
