"""Files and folders that only their owner may read, whatever the umask is.

On a system without such permissions (Windows), the permissions of the folder apply: a user's folder is
private there.
"""

from __future__ import annotations

import os
import stat
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

import structlog

from labos.clock import SystemClock

FILE, FOLDER = 0o600, 0o700

LEFT_S = 3600.0
"""A half written file that is older than this was left behind."""

_log = structlog.get_logger(__name__)


def create_file(path: Path, *, exclusive: bool = False) -> BinaryIO:
    """Open a file for writing. It is empty or new, and private from the first moment. Raises OSError."""
    flags = os.O_WRONLY | os.O_CREAT | (os.O_EXCL if exclusive else os.O_TRUNC) | getattr(os, "O_BINARY", 0)
    handle = os.open(path, flags, FILE)
    try:
        if os.name != "nt":
            os.fchmod(handle, FILE)  # else an existing file keeps its permissions
        return os.fdopen(handle, "wb")
    except BaseException:
        os.close(handle)
        raise


def replace_file(path: Path, data: bytes) -> None:
    """Write a private file, completely or not at all; it is synced on return. Raises OSError."""
    with open_replacement(path) as file:
        file.write(data)


@contextmanager
def open_replacement(path: Path) -> Iterator[BinaryIO]:
    """A private file to write in the block, for data that should not be in memory as a whole."""
    beside = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}.part")
    try:
        with create_file(beside) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


_making = threading.Lock()


def make_database_file(path: Path) -> None:
    """Make an empty private file if there is none. Raises OSError.

    An existing file is not opened, not even for a moment: closing it would release every lock that SQLite
    holds on it for this process (POSIX locks belong to the process). The next program that closes the
    database would then assume that it is the last one, and remove the write-ahead log of the others.
    """
    with _making:  # no other thread may open a file that this one closes
        if path.exists():
            return
        with suppress(FileExistsError):
            os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, FILE))


def make_folder(path: Path) -> list[Path]:
    """Make a folder and its parents; the new ones are private. Returns the new ones, the outermost first.
    Raises OSError."""
    missing = []
    folder = path
    while not folder.is_dir():
        missing.append(folder)
        folder = folder.parent
    missing.reverse()
    for each in missing:
        each.mkdir(mode=FOLDER, exist_ok=True)
    return missing


def tighten(paths: Iterable[Path], what: str) -> None:
    """Remove the permissions of other users from existing files and folders, and report that in one line of
    the program's log. Files of another owner are not changed."""
    if os.name == "nt":
        return
    changed = [path for path in paths if _tighten(path)]
    if changed:
        _log.warning("made_private", what=what, first=str(changed[0]), number=len(changed))


def _tighten(path: Path) -> bool:
    try:
        found = path.lstat()
        mode = stat.S_IMODE(found.st_mode)
        if stat.S_ISLNK(found.st_mode) or not mode & 0o077 or _is_common(path, mode):
            return False
        path.chmod(mode & FOLDER)
    except OSError:
        return False
    return True


def _is_common(path: Path, mode: int) -> bool:
    """Whether a folder also has other purposes: it was named as a lab's folder, but contains more than the
    lab."""
    return bool(mode & stat.S_ISVTX) or path == path.parent or path == Path.home()


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable. Windows neither can nor needs to. Raises OSError."""
    if os.name == "nt":  # pragma: no cover
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def remove_leftovers(folder: Path, pattern: str) -> None:
    """Remove files that a process left behind when it died while writing them, and report that in one line of
    the program's log. Files of the last hour are not removed, as their writers may still be at work."""
    now = SystemClock().now_ns() / 1e9
    removed = 0
    for path in folder.glob(pattern):
        try:
            if now - path.stat().st_mtime > LEFT_S:
                path.unlink()
                removed += 1
        except OSError:
            continue
    if removed:
        _log.warning("leftovers_removed", folder=str(folder), number=removed)
