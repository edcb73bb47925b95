"""Parses the URLs of databases, and shows them without the password."""

from __future__ import annotations

from pathlib import Path

from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError

from labos.errors import BadInput

EXAMPLES = "Use sqlite:///lab.db or postgresql://user:password@host/database."


def parse_url(url: str) -> URL:
    """The URL with the driver that LabOS uses. Raises BadInput for a URL of neither SQLite nor PostgreSQL.
    The message never contains the URL, which may contain a password."""
    try:
        parsed = make_url(url)
    except (ArgumentError, ValueError):
        raise BadInput("The database URL cannot be read.", remedy=EXAMPLES) from None
    backend = parsed.get_backend_name()
    if backend == "sqlite":
        if not parsed.database or parsed.database == ":memory:" or parsed.query:
            raise BadInput(
                "The log needs its own file: the SQLite URL names no file, or has options.",
                remedy="Use sqlite:///lab.db (relative) or sqlite:////var/lib/labos/lab.db (absolute).",
            )
        return parsed.set(drivername="sqlite+pysqlite")
    if backend in ("postgresql", "postgres"):
        if not parsed.database:
            raise BadInput("The PostgreSQL URL names no database.", remedy=EXAMPLES)
        return parsed.set(drivername="postgresql+psycopg")
    raise BadInput(f"LabOS keeps its log in SQLite or PostgreSQL, not in {backend!r}.", remedy=EXAMPLES)


def display_name(url: URL) -> str:
    """The name of the database for messages: without password and options."""
    if url.get_backend_name() == "sqlite":
        return f"SQLite database {find_sqlite_path(url)}"
    host = url.host or url.query.get("host") or "localhost"
    at = f"{url.username}@{host}" if url.username else f"{host}"
    port = f":{url.port}" if url.port else ""
    return f"PostgreSQL database {at}{port}/{url.database}"


def find_sqlite_path(url: URL) -> Path:
    """The file of a SQLite URL, absolute, so that messages and locks do not depend on the
    working directory."""
    return Path(url.database or "").absolute()
