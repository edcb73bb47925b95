"""Opens the store for a URL: the only place that chooses between SQLite and PostgreSQL."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy.engine import URL

from labos.errors import StoreUnavailable
from labos.private import tighten
from labos.store import _migrate
from labos.store._backend import Backend
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
