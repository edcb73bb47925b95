"""Queries about a database without reading its log: the present kernel, its size, its name."""

from __future__ import annotations

from pathlib import Path

from sqlalchemy import text

from labos.errors import StoreError
from labos.store._backend import find_holder
from labos.store._open import use_backend
from labos.store._url import find_sqlite_path, parse_url


def find_lease_holder(url: str) -> str:
    """The present kernel on this database; empty if there is none, or if this cannot be found out.

    A kernel that was killed does not count, even if its lease has not expired: its lock was released when it
    died. Raises BadInput for a URL that cannot be used.
    """
    parsed = parse_url(url)
    if parsed.get_backend_name() == "sqlite" and not find_sqlite_path(parsed).is_file():
        return ""
    try:
        with use_backend(parsed) as backend:
            found = find_holder(backend)
    except StoreError:
        return ""
    return found.owner or "kernel" if found.locked else ""


def find_silent_holder(url: str) -> str:
    """The last kernel on this database, if it neither released the lab nor lives; otherwise empty. Raises
    BadInput for a URL that cannot be used, StoreUnavailable."""
    with use_backend(parse_url(url)) as backend:
        found = find_holder(backend)
        return "" if found.living else found.owner


def measure_database(url: str) -> int:
    """The size of the database in bytes, with its write-ahead log. Raises StoreUnavailable."""
    file = find_database_file(url)
    if file is not None:
        files = (file, file.with_name(file.name + "-wal"))
        return sum(part.stat().st_size for part in files if part.is_file())
    with use_backend(parse_url(url)) as backend, backend.reading.connect() as connection:
        return int(connection.execute(text("SELECT pg_database_size(current_database())")).scalar_one())


def is_replica(url: str) -> bool:
    """Whether a database is a replica of another one, so that it cannot be written. Raises
    StoreUnavailable."""
    if find_database_file(url) is not None:
        return False
    with use_backend(parse_url(url)) as backend, backend.reading.connect() as connection:
        return bool(connection.execute(text("SELECT pg_is_in_recovery()")).scalar())


def find_database_file(url: str) -> Path | None:
    """The file of a SQLite database; None for one on a server. Raises BadInput."""
    parsed = parse_url(url)
    return find_sqlite_path(parsed) if parsed.get_backend_name() == "sqlite" else None


def show_url(url: str) -> str:
    """The URL without its password. Raises BadInput."""
    parsed = parse_url(url)
    return parsed.set(drivername=parsed.get_backend_name()).render_as_string(hide_password=True)
