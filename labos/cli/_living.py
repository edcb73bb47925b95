"""Whether a kernel lives on a database: its lease says so, by the database's own clock."""

from __future__ import annotations

from sqlalchemy import select, text
from sqlalchemy.engine import URL

from labos.cli._query import now_ns
from labos.errors import StoreError
from labos.ports import Head
from labos.store._errors import Door
from labos.store._open import backend_for
from labos.store._tables import head
from labos.store._url import parse_url, sqlite_path


def silent_kernel(url: str) -> str:
    """The owner of a lease that has expired and was never given back: a kernel that died. Raises
    StoreUnavailable."""
    parsed = parse_url(url)
    backend = backend_for(parsed)
    try:
        with Door(parsed), backend.reading.connect() as connection:
            query = select(head.c.lease_owner).where(head.c.lease_until <= backend.now_ms)
            return str(connection.execute(query).scalar_one_or_none() or "")
    finally:
        backend.close()


def living_kernel(url: str) -> str:
    """The owner of a lease that has not expired; empty if there is none or no telling."""
    parsed = parse_url(url)
    if parsed.get_backend_name() == "sqlite" and not sqlite_path(parsed).is_file():
        return ""
    backend = backend_for(parsed)
    try:
        with Door(parsed), backend.reading.connect() as connection:
            query = select(head.c.lease_owner).where(head.c.lease_until > backend.now_ms)
            owner = connection.execute(query).scalar_one_or_none()
            return "" if owner is None else str(owner) or "kernel"
    except StoreError:
        return ""
    finally:
        backend.close()


def lab_now(url: str, head: Head) -> int:
    """The present (UTC ns) where a kernel lives; else the last event, for nothing went on since."""
    return max(now_ns(), head.recorded_at) if living_kernel(url) else head.recorded_at


def database_bytes(url: str) -> int:
    """How much room the database takes, its write-ahead log included. Raises StoreUnavailable."""
    parsed = parse_url(url)
    if parsed.get_backend_name() == "sqlite":
        path = sqlite_path(parsed)
        files = (path, path.with_name(path.name + "-wal"))
        return sum(file.stat().st_size for file in files if file.is_file())
    backend = backend_for(parsed)
    try:
        with Door(parsed), backend.reading.connect() as connection:
            return int(connection.execute(text("SELECT pg_database_size(current_database())")).scalar_one())
    finally:
        backend.close()


def shown_url(url: str) -> str:
    """The URL without its password."""
    parsed: URL = parse_url(url)
    plain = parsed.set(drivername=parsed.get_backend_name())
    return plain.render_as_string(hide_password=True)
