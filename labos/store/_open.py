"""Opens the store for a URL: the only place that chooses between SQLite and PostgreSQL. And queries about a
database without reading its log: the present kernel, its size, its name."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import text
from sqlalchemy.engine import URL

from labos.errors import StoreError, StoreUnavailable
from labos.private import tighten
from labos.store import _migrate
from labos.store._backend import Backend, find_holder
from labos.store._errors import TranslatedErrors
from labos.store._event_store import SqlEventStore
from labos.store._sqlite import SqliteBackend
from labos.store._url import find_sqlite_path, parse_url


def open_store(
    url: str, *, create: bool = True, read_only: bool = False, home: Path | None = None
) -> SqlEventStore:
    """Open the log at ``sqlite:///file`` or ``postgresql://user:password@host/database``. ``home`` is the
    lab's folder with the key of its snapshots. Without a key, snapshots are neither stored nor used.

    With ``create``, an empty database gets its tables and an older one is migrated. With ``read_only``,
    nothing is created or changed and every write is refused. Raises BadInput for a URL that cannot be used,
    LogTooNew for a database of a newer LabOS (nothing is touched), StoreUnavailable for one that cannot be
    reached.
    """
    parsed = parse_url(url)
    if create and not read_only:
        _migrate.migrate(url)
        tighten(_list_own_files(parsed, home), "the lab's folder, key and database")
    else:
        _expect_current(_migrate.read_database_status(url))
    with TranslatedErrors(parsed):
        return SqlEventStore(parsed, choose_backend(parsed), read_only=read_only, home=home)


def scrub_words(url: str) -> str:
    """Remove all erased words from a database's files; returns why some may remain, empty if none does.
    Raises StoreUnavailable."""
    _expect_current(_migrate.read_database_status(url))
    with use_backend(parse_url(url)) as backend:
        return backend.scrub()


def _list_own_files(url: URL, home: Path | None) -> list[Path]:
    """The parts of a lab that only its owner may read: its folder with all files, and the database, which may
    be elsewhere."""
    files = [home] if home is not None else []
    if url.get_backend_name() == "sqlite":
        file = find_sqlite_path(url)
        files += [file.with_name(file.name + end) for end in ("", "-wal", "-shm", ".kernel.lock")]
    return files


def choose_backend(url: URL) -> Backend:
    """The backend for a parsed URL."""
    if url.get_backend_name() == "sqlite":
        return SqliteBackend(url)
    from labos.store._postgres import PostgresBackend

    return PostgresBackend(url)


@contextmanager
def use_backend(url: URL) -> Iterator[Backend]:
    """A backend that is closed afterwards. The database's errors are translated."""
    with TranslatedErrors(url):
        backend = choose_backend(url)
        try:
            yield backend
        finally:
            backend.close()


def _expect_current(status: _migrate.DatabaseStatus) -> None:
    _migrate.refuse_newer(status)
    if status.state == "missing":
        raise StoreUnavailable(
            f"There is no {status.name}.", remedy="Check the path, or start a kernel to create it."
        )
    if status.state != "current":
        found = f"revision {status.revision}" if status.revision else "no log yet"
        raise StoreUnavailable(
            f"The {status.name} is not ready: it has {found}, and this LabOS needs {status.expected}.",
            remedy="Start a kernel on it, or migrate it.",
        )


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
