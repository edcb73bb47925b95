"""Brings a database to the revision that this LabOS writes, by Alembic's migrations.

Alembic is loaded only when there is something to migrate: a kernel's start does not pay for it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from sqlalchemy import Connection, Engine, inspect, text
from sqlalchemy.engine import URL

from labos.errors import LogTooNew, StoreUnavailable
from labos.imports import import_without
from labos.private import make_folder
from labos.store._errors import TranslatedErrors
from labos.store._tables import VERSION_TABLE
from labos.store._url import display_name, find_sqlite_path, parse_url

if TYPE_CHECKING:
    from alembic.config import Config

REVISION = "0003"
"""The revision that this version of LabOS reads and writes."""

_MIGRATION_LOCK = 0x4C61624D
"""PostgreSQL's advisory lock that two migrating programs contend for ("LabM")."""


class DatabaseStatus(msgspec.Struct, frozen=True):
    """The state of a database for migrations.

    ``state`` is ``missing`` (no file), ``empty`` (no tables of LabOS), ``older``, ``current`` or ``newer``;
    ``revision`` is its revision, ``expected`` the one that this LabOS needs.
    """

    name: str
    state: str
    revision: str
    expected: str = REVISION


def find_migrations_folder() -> Path:
    """The folder of the migrations: in the installed package, otherwise in the checkout."""
    here = Path(__file__).resolve()
    for folder in (here.parents[1] / "_migrations", here.parents[2] / "migrations"):
        if (folder / "env.py").is_file():
            return folder
    raise StoreUnavailable(
        "The database migrations are missing from this installation of LabOS.",
        remedy="Install labos-sdl again.",
    )


def alembic_config() -> Config:
    """Alembic's configuration, made in code: no alembic.ini is needed."""
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(find_migrations_folder()).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    return config


def migrate(url: str) -> str:
    """Bring an empty or older database to this version's revision; returns the revision.

    Raises LogTooNew for a database of a newer LabOS, which is left untouched, and StoreUnavailable if the
    database cannot be reached or written.
    """
    parsed = parse_url(url)
    with TranslatedErrors(parsed):
        if parsed.get_backend_name() == "sqlite":
            make_folder(find_sqlite_path(parsed).parent)
        status = _status(parsed)
        if status.state != "current":
            refuse_newer(status)
            _upgrade(parsed)
    return REVISION


def read_database_status(url: str) -> DatabaseStatus:
    """The state of a database; nothing is created or changed. Raises StoreUnavailable."""
    parsed = parse_url(url)
    with TranslatedErrors(parsed):
        return _status(parsed)


def refuse_newer(status: DatabaseStatus) -> None:
    """Raise LogTooNew if a newer LabOS wrote the database."""
    if status.state == "newer":
        raise LogTooNew(
            f"The {status.name} was written by a newer LabOS (revision {status.revision}; "
            f"this one knows {status.expected}). It was not touched.",
            remedy="Upgrade this installation: pip install --upgrade labos-sdl",
        )


def _status(url: URL) -> DatabaseStatus:
    name = display_name(url)
    if url.get_backend_name() == "sqlite" and not find_sqlite_path(url).is_file():
        return DatabaseStatus(name, "missing", "")
    from labos.store._open import use_backend

    with use_backend(url) as backend:
        revision = _read_revision(backend.reading, name)
    if revision == REVISION:
        state = "current"
    elif not revision:
        state = "empty"
    else:
        state = "older" if revision in _list_revisions() else "newer"
    return DatabaseStatus(name, state, revision)


def _read_revision(engine: Engine, name: str) -> str:
    with engine.connect() as connection:
        tables = set(inspect(connection).get_table_names())
        if VERSION_TABLE in tables:
            row = connection.execute(text(f"SELECT version_num FROM {VERSION_TABLE}")).first()
            if row is not None:
                return str(row[0])
        if tables & {"event", "head", "snapshot"}:
            raise StoreUnavailable(
                f"The {name} has tables that are not LabOS's own.",
                remedy="Give LabOS a database of its own.",
            )
    return ""


def _list_revisions() -> set[str]:
    from alembic.script import ScriptDirectory

    scripts = ScriptDirectory.from_config(alembic_config())
    return {script.revision for script in scripts.walk_revisions()}


def find_schema_of_log(connection: Connection) -> str:
    """The PostgreSQL schema with the log, quoted; empty if there is none. It need not be the first schema in
    a role's search path: for a role `labos`, the schema of the views comes before it."""
    found = connection.execute(
        text(
            "SELECT quote_ident(nspname) FROM pg_class JOIN pg_namespace ON pg_namespace.oid = relnamespace "
            "WHERE pg_class.oid = to_regclass('event')"
        )
    ).scalar()
    return str(found or "")


def _upgrade(url: URL) -> None:
    # Alembic's templates would load Pygments only to colour their own errors.
    command = import_without("alembic.command", "pygments")
    config = alembic_config()
    with migration_connection(url) as connection:
        if connection.dialect.name == "postgresql":
            encoding = connection.execute(text("SHOW server_encoding")).scalar_one()
            if encoding != "UTF8":
                raise StoreUnavailable(
                    f"The {display_name(url)} has the encoding {encoding}, which cannot hold every text.",
                    remedy="Create it with ENCODING 'UTF8' TEMPLATE template0.",
                )
            if schema := find_schema_of_log(connection):
                connection.execute(
                    text("SELECT set_config('search_path', :schema, true)"), {"schema": schema}
                )
        config.attributes["connection"] = connection
        command.upgrade(config, "head")


@contextmanager
def migration_connection(url: URL) -> Iterator[Connection]:
    """A connection in one exclusive transaction, for migrations."""
    from labos.store._open import use_backend

    with use_backend(url) as backend, backend.writing.connect() as connection, connection.begin():
        if connection.dialect.name == "postgresql":
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _MIGRATION_LOCK})
        yield connection
