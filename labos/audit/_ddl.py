"""The statements that make tables and views, for SQLite and PostgreSQL."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from labos.audit.tables import TABLES, VIEWS, Table

Dialect = Literal["sqlite", "postgresql"]

TABLE_SCHEMA = "labos_audit"
"""The schema of the tables in PostgreSQL, which only the projector needs."""

VIEW_SCHEMA = "labos"
"""The schema of the views in PostgreSQL, which people may be allowed to read."""

STATE = "projection"
"""A table with one row: the version of the tables, and the position up to which they contain the log. Its
view has the same name."""

_TYPES: dict[Dialect, dict[str, str]] = {
    "sqlite": {
        "text": "TEXT",
        "integer": "INTEGER",
        "number": "REAL",
        "flag": "INTEGER",
        "json": "TEXT",
        "time": "REAL",
    },
    "postgresql": {
        "text": "text",
        "integer": "bigint",
        "number": "double precision",
        "flag": "boolean",
        "json": "json",
        "time": "double precision",
    },
}

_MOMENTS: dict[Dialect, str] = {
    "sqlite": "strftime('%Y-%m-%dT%H:%M:%fZ', {0}, 'unixepoch')",
    "postgresql": "to_timestamp({0})",
}


def table_name(name: str, dialect: Dialect) -> str:
    """The full name of a table. SQLite has no schemas: there the names of tables begin with ``labos_``."""
    return f'{TABLE_SCHEMA}."{name}"' if dialect == "postgresql" else f'"labos_{name}"'


def view_name(name: str, dialect: Dialect) -> str:
    return f'{VIEW_SCHEMA}."{name}"' if dialect == "postgresql" else f'"{name}"'


def write_select(table: Table, dialect: Dialect) -> str:
    """The query for the row of a key."""
    columns = ", ".join(f'"{name}"' for name in table.stored)
    where = " AND ".join(f'"{name}" = ?' for name in table.key)
    return f"SELECT {columns} FROM {table_name(table.name, dialect)} WHERE {where}"


def make_all(dialect: Dialect) -> Iterator[str]:
    """Statements that create everything in an empty database; those for the state come first."""
    if dialect == "postgresql":
        yield f"CREATE SCHEMA IF NOT EXISTS {TABLE_SCHEMA}"
        yield f"CREATE SCHEMA IF NOT EXISTS {VIEW_SCHEMA}"
    whole, number = _TYPES[dialect]["integer"], _TYPES[dialect]["number"]
    yield (
        f"CREATE TABLE {table_name(STATE, dialect)} (id {whole} PRIMARY KEY CHECK (id = 1), "
        f"version {whole} NOT NULL, lab TEXT NOT NULL, position {whole} NOT NULL, "
        f"hash TEXT NOT NULL, at_s {number})"
    )
    for table in TABLES:
        yield _table(table, dialect)
        if dialect == "postgresql":
            yield from _forbid_samples(table)
        for columns in table.indexes:
            name = f"labos_{table.name}_{'_'.join(columns)}"
            listed = ", ".join(f'"{column}"' for column in columns)
            yield f'CREATE INDEX "{name}" ON {table_name(table.name, dialect)} ({listed})'
        if table.searched:
            yield from _write_words_index(table, dialect)
    for table in VIEWS:
        yield _view(table, dialect)
    at = _MOMENTS[dialect].format("at_s")
    yield (
        f"CREATE VIEW {view_name(STATE, dialect)} AS SELECT lab, position, {at} AS at, at_s, version "
        f"FROM {table_name(STATE, dialect)}"
    )


def drop_all(dialect: Dialect) -> Iterator[str]:
    """Statements that remove all our tables and views; missing ones are ignored."""
    if dialect == "postgresql":
        yield f"DROP SCHEMA IF EXISTS {TABLE_SCHEMA} CASCADE"
        return
    for name in (STATE, *(table.view for table in VIEWS)):
        yield f"DROP VIEW IF EXISTS {view_name(name, dialect)}"
    for table in TABLES:
        if table.searched:
            yield f"DROP TABLE IF EXISTS {words_name(table)}"
    for name in (STATE, *(table.name for table in TABLES)):
        yield f"DROP TABLE IF EXISTS {table_name(name, dialect)}"


def _table(table: Table, dialect: Dialect) -> str:
    columns = [f'"{column.stored}" {_TYPES[dialect][column.kind]}' for column in table.columns]
    key = ", ".join(f'"{name}"' for name in table.key)
    # Rows of a table with a key of several parts are stored in the order of the key: it needs no further
    # index.
    compact = " WITHOUT ROWID" if dialect == "sqlite" and len(table.key) > 1 else ""
    made = f"CREATE TABLE {table_name(table.name, dialect)} ({', '.join(columns)}, PRIMARY KEY ({key}))"
    return f"{made}{compact}"


def _forbid_samples(table: Table) -> Iterator[str]:
    """Forbid PostgreSQL to take samples of people's words, which would remain in its catalogue after an
    erasure."""
    for column in table.columns:
        if column.by_people:
            name = table_name(table.name, "postgresql")
            yield f'ALTER TABLE {name} ALTER COLUMN "{column.stored}" SET STATISTICS 0'


def words_name(table: Table) -> str:
    """The name of SQLite's word index of a table, which is a separate table."""
    return table_name(f"{table.name}_words", "sqlite")


def write_vector(table: Table) -> str:
    """PostgreSQL's search vector of a row, as in its index."""
    return f"array_to_tsvector(string_to_array(\"{table.searched}\", ' '))"


def _write_words_index(table: Table, dialect: Dialect) -> Iterator[str]:
    """Statements for a word index. In SQLite triggers update it, because a replaced row is deleted."""
    if dialect == "postgresql":
        yield (
            f'CREATE INDEX "labos_{table.name}_words" ON {table_name(table.name, dialect)} '
            f"USING gin ({write_vector(table)})"
        )
        yield f'ALTER INDEX {TABLE_SCHEMA}."labos_{table.name}_words" ALTER COLUMN 1 SET STATISTICS 0'
        return
    (key,), column = table.key, table.searched
    name, made = table_name(table.name, dialect), words_name(table)
    yield (
        f'CREATE VIRTUAL TABLE {made} USING fts5("{column}", content={name}, content_rowid="{key}", '
        "tokenize=ascii, detail=none)"
    )
    quoted = made.strip('"')
    yield (
        f'CREATE TRIGGER "{quoted}_added" AFTER INSERT ON {name} BEGIN '
        f'INSERT INTO {made} (rowid, "{column}") VALUES (new."{key}", new."{column}"); END'
    )
    yield (
        f'CREATE TRIGGER "{quoted}_deleted" AFTER DELETE ON {name} BEGIN '
        f'INSERT INTO {made} ({made}, rowid, "{column}") '
        f'VALUES (\'delete\', old."{key}", old."{column}"); END'
    )


def _view(table: Table, dialect: Dialect) -> str:
    shown = []
    for column in table.columns:
        if column.kind == "time":
            moment = _MOMENTS[dialect].format(f'"{column.stored}"')
            shown.append(f'{moment} AS "{column.name}"')
        shown.append(f'"{column.stored}"')
    return (
        f"CREATE VIEW {view_name(table.view, dialect)} AS SELECT {', '.join(shown)} "
        f"FROM {table_name(table.name, dialect)}"
    )
