"""Translates a database's errors into LabOS' own; the only place that does."""

from __future__ import annotations

import shutil
from types import TracebackType

from sqlalchemy.engine import URL
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from labos.errors import InvariantBroken, LabosError, StoreUnavailable
from labos.store._url import display_name, find_sqlite_path

_RESTORE = "Restore it from a backup, or name another file."

_REMEDIES: tuple[tuple[tuple[str, ...], str], ...] = (
    (
        ("disk is full", "no space left", "disk full", "file too large"),
        "Free some space on its disk.",
    ),
    (
        ("must be owner", "permission denied for schema"),
        "Only the owner of the tables may do that: name the owner's URL (labos db upgrade --database URL).",
    ),
    (
        ("readonly", "read-only", "permission denied", "insufficient privilege", "unable to open"),
        "Check that its file, folder or role may be written by the user who runs LabOS.",
    ),
    (
        ("database is locked", "database table is locked", "lock timeout", "lock_timeout"),
        "Another program has locked it: close that program.",
    ),
    (
        ("not a database", "malformed", "decode to utf-8"),
        _RESTORE,
    ),
    (("password authentication", "no password supplied", "role "), "Check user and password in the URL."),
    (
        ("does not exist", "no such table"),
        "Create the database, or check its name in the URL.",
    ),
    (
        ("connection refused", "could not translate", "failed to resolve", "timeout expired", "no such file"),
        "Check that the server runs and that host and port in the URL are right.",
    ),
    (
        ("disk i/o error", "input/output error"),
        "Check the disk and the system's log.",
    ),
)
LEAST_FREE = 64 * 1024
"""With less free space than this, SQLite cannot even start."""

_OTHERWISE = "Check that the database runs and can be reached."


def translate_error(url: URL, error: BaseException) -> LabosError | None:
    """LabOS' error for a database's error; None if it is an unexpected error of LabOS itself."""
    names = _list_dbapi_names(error)
    if names & {"IntegrityError", "DataError"}:
        return InvariantBroken(
            f"The {display_name(url)} refused a batch that contradicts the log "
            f"({_describe_error(url, error)}); nothing of it was written.",
            remedy="Verify the log; if it is sound, this is an error in LabOS.",
        )
    if isinstance(error, ModuleNotFoundError) and "psycopg" in str(error):
        return StoreUnavailable(
            "PostgreSQL needs the psycopg driver, which is not installed.",
            remedy='Run: pip install "labos-sdl[postgres]"',
        )
    if isinstance(error, UnicodeDecodeError):
        return StoreUnavailable(
            f"The {display_name(url)} is damaged: a text in it is not UTF-8.", remedy=_RESTORE
        )
    if isinstance(error, (SQLAlchemyError, OSError)) or "Error" in names:
        reason = _describe_error(url, error)
        return StoreUnavailable(
            f"The {display_name(url)} is not available: {reason}.", remedy=find_remedy(reason)
        )
    return None


def find_remedy(reason: str) -> str:
    """The remedy for a driver's message."""
    lowered = reason.lower()
    for words, remedy in _REMEDIES:
        if any(word in lowered for word in words):
            return remedy
    return _OTHERWISE


def _list_dbapi_names(error: BaseException) -> set[str]:
    """The DB-API 2.0 names of an error of sqlite3 or psycopg, wrapped by SQLAlchemy or not."""
    origin = error.orig if isinstance(error, DBAPIError) else error
    return {c.__name__ for c in type(origin).__mro__ if c.__module__.partition(".")[0] in _DRIVERS}


_DRIVERS = ("sqlite3", "psycopg")


def _describe_error(url: URL, error: BaseException) -> str:
    """The driver's message in one line, without SQL and without the password."""
    origin = error.orig if isinstance(error, DBAPIError) and error.orig is not None else error
    lines = [line.strip() for line in str(origin).splitlines() if line.strip()]
    text = (lines[0] if lines else type(origin).__name__).rstrip(".")
    if "disk i/o error" in text.lower() and _is_full(url):
        # SQLite reports nothing else when there is no room for its shared memory.
        text += ", as its disk is full"
    return text.replace(url.password, "***") if url.password else text


def _is_full(url: URL) -> bool:
    try:
        return shutil.disk_usage(find_sqlite_path(url).parent).free < LEAST_FREE
    except OSError:
        return False


class TranslatedErrors:
    """Context in which a database's errors are translated."""

    __slots__ = ("_url",)

    def __init__(self, url: URL) -> None:
        self._url = url

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None or isinstance(error, LabosError):
            return
        translated = translate_error(self._url, error)
        if translated is not None:
            raise translated from error
