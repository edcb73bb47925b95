"""Files and folders that only their owner may read, whatever the umask says.

Where the system knows no such rights (Windows), the folder's own rights hold: a user's folder is private
there.
"""

from __future__ import annotations

import os
import stat
import threading
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

import structlog

from labos.clock import SystemClock

FILE, FOLDER = 0o600, 0o700

LEFT_S = 3600.0
"""A file that is half written and so old was left behind."""

_log = structlog.get_logger(__name__)


def create_file(path: Path, *, exclusive: bool = False) -> BinaryIO:
    """Open a file for writing, emptied or new, and private from the first moment. Raises OSError."""
    flags = os.O_WRONLY | os.O_CREAT | (os.O_EXCL if exclusive else os.O_TRUNC) | getattr(os, "O_BINARY", 0)
    handle = os.open(path, flags, FILE)
    try:
        if os.name != "nt":
            os.fchmod(handle, FILE)  # one that was there keeps its rights otherwise
        return os.fdopen(handle, "wb")
    except BaseException:
        os.close(handle)
        raise


def replace_file(path: Path, data: bytes) -> None:
    """Write a private file, whole or not at all, synced on return. Raises OSError."""
    beside = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}.part")
    try:
        with create_file(beside) as file:
            file.write(data)
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

    A file that is there is not opened, not even for a moment: to close it would drop every lock that SQLite
    holds on it for this process (POSIX locks belong to the process). The next program to close the database
    would then believe that it is the last one and remove the write-ahead log of the others.
    """
    with _making:  # nor does another thread open what this one is about to close
        if path.exists():
            return
        with suppress(FileExistsError):
            os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, FILE))


def make_folder(path: Path) -> list[Path]:
    """Make a folder and its parents; those that are new are private. Returns them, the outermost first.
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
    """Take away what others than the owner may do with files and folders that are there. One line in the
    journal of the program says so. What belongs to somebody else stays as it is."""
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
    """Whether a folder is for more than one thing: it was named as a lab's, but is not the lab's alone."""
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
    """Remove files that whoever died while writing them left behind; one line in the journal of the program
    says so. Those of the last hour may still be at work."""
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
