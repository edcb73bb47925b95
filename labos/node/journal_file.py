"""A node's journal on disk."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from labos.node.journal import JournalError
from labos.node.worker import Worker
from labos.private import FILE, create_file, make_folder, sync_folder

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl


class FileJournalFile:
    """One file, written and synced in a thread of its own so that the event loop never waits
    for the disk. ``<path>.lock`` keeps a second process out; the system lets it go when its
    owner dies. Raises JournalError."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        make_folder(self.path.parent)
        self._lock = _lock(self.path.with_name(self.path.name + ".lock"))
        self._in_thread = Worker("journal")
        self._fd = -1
        self._end = 0

    async def read(self) -> bytes:
        data: bytes = await self._in_thread(self._read)
        return data

    async def append(self, data: bytes) -> None:
        await self._in_thread(lambda: self._append(data))

    async def replace(self, data: bytes) -> None:
        await self._in_thread(lambda: self._replace(data))

    async def close(self) -> None:
        await self._in_thread(self._release)
        self._in_thread.close()
        os.close(self._lock)

    # -- in the thread -----------------------------------------------------------------------

    def _read(self) -> bytes:
        data = self.path.read_bytes() if self.path.exists() else b""
        self._open()
        return data

    def _append(self, data: bytes) -> None:
        if self._fd < 0:
            self._open()
        try:
            # A disk that fills up takes a part and says how much.
            rest = memoryview(data)
            while rest:
                rest = rest[os.write(self._fd, rest) :]
            os.fsync(self._fd)
        except OSError:
            # A half line in the middle of a journal would be damage.
            os.ftruncate(self._fd, self._end)
            raise
        self._end += len(data)

    def _replace(self, data: bytes) -> None:
        fresh = self.path.with_name(self.path.name + ".new")
        with create_file(fresh) as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        # Windows does not replace a file that is open.
        self._release()
        os.replace(fresh, self.path)
        sync_folder(self.path.parent)
        self._open()

    def _open(self) -> None:
        self._release()
        flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0)
        self._fd = os.open(self.path, flags, FILE)
        self._end = os.fstat(self._fd).st_size

    def _release(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


def _lock(path: Path) -> int:
    """Take the lock that says that this process, and no other, writes the journal."""
    fd = os.open(path, os.O_RDWR | os.O_CREAT, FILE)
    try:
        if sys.platform == "win32":
            msvcrt.locking(fd, msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(fd)
        raise JournalError(
            f"The journal {path.with_suffix('')} is in use by another process.",
            remedy="Each module needs a journal of its own; or is this node running already?",
        ) from error
    return fd
