"""A node's journal on disk."""

from __future__ import annotations

import os
from pathlib import Path

from labos.lockfile import FileLock
from labos.node.journal import JournalError
from labos.node.worker import Worker
from labos.private import FILE, make_folder, replace_file

_IN_USE = "process {}"
"""The text in the lock file of a journal that is in use."""


def find_process(path: Path) -> int:
    """The process that has the journal at ``path`` open; 0 if none has."""
    lock = _make_lock(path)
    number = lock.note().removeprefix(_IN_USE.format(""))
    return int(number) if lock.is_taken() and number.isdecimal() else 0


def _make_lock(path: Path) -> FileLock:
    return FileLock(path.with_name(path.name + ".lock"))


class FileJournalFile:
    """One file, written and synced in its own thread, so that the event loop never waits for the disk.
    ``<path>.lock`` excludes a second process; the system releases it when its owner dies. Raises
    JournalError."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        make_folder(self.path.parent)
        self._lock = _make_lock(self.path)
        if not self._lock.acquire(_IN_USE.format(os.getpid())):
            raise JournalError(
                f"The journal {self.path} is in use by another process.",
                remedy="Each module needs a journal of its own; or is this node running already?",
            )
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
        self._lock.release()

    # -- in the thread -----------------------------------------------------------------------

    def _read(self) -> bytes:
        data = self.path.read_bytes() if self.path.exists() else b""
        self._open()
        return data

    def _append(self, data: bytes) -> None:
        if self._fd < 0:
            self._open()
        try:
            # A disk that is nearly full accepts a part, and returns its length.
            rest = memoryview(data)
            while rest:
                rest = rest[os.write(self._fd, rest) :]
            os.fsync(self._fd)
        except OSError:
            # A part of a line in the middle of a journal would be damage.
            os.ftruncate(self._fd, self._end)
            raise
        self._end += len(data)

    def _replace(self, data: bytes) -> None:
        self._release()  # Windows cannot replace an open file
        replace_file(self.path, data)
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
