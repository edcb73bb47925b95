"""A lock that the operating system releases when its holder dies."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

_MARK = 1 << 30
"""Windows locks bytes and hides them from other processes, so the locked byte is far behind the text."""

if sys.platform == "win32":  # pragma: no cover
    import msvcrt

    def _try_lock(file: int) -> bool:
        os.lseek(file, _MARK, os.SEEK_SET)
        try:
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

    _try_look = _try_lock

else:
    import fcntl

    def _try_lock(file: int) -> bool:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def _try_look(file: int) -> bool:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True


LOOKS = 10
LOOK_S = 0.02
"""A process that calls ``is_taken`` holds the lock for some microseconds, so a lock is tried several
times."""


class FileLock:
    """An exclusive lock on a file, held until ``release`` or until the process ends.

    The file is not removed: otherwise two processes could lock two different files with one name.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: int | None = None

    @property
    def is_held(self) -> bool:
        return self._file is not None

    def acquire(self, note: str) -> bool:
        """Take the lock and write ``note`` into the file; False if another process holds the lock."""
        if self.is_held:
            return True
        for look in range(LOOKS):
            if look:
                time.sleep(LOOK_S)
            file = self._open_locked()
            if file is not None:
                break
        else:
            return False
        self._file = file
        try:
            os.ftruncate(file, 0)
            os.lseek(file, 0, os.SEEK_SET)
            os.write(file, note.encode())
        except OSError:
            # The note is only information for people; on a full disk the lock is valid without it.
            pass
        return True

    def is_taken(self) -> bool:
        """Whether any process holds the lock, this object included. True if that cannot be found out."""
        if self.is_held:
            return True
        try:
            file = os.open(self.path, os.O_RDONLY)
        except FileNotFoundError:
            return False
        except OSError:
            return True
        try:
            return not _try_look(file)
        except OSError:
            return True
        finally:
            os.close(file)

    def note(self) -> str:
        """The note that the present holder has written into the file."""
        try:
            return self.path.read_text(encoding="utf-8", errors="replace").strip()
        except OSError:
            return ""

    def release(self) -> None:
        if self._file is not None:
            # Closing the file releases the lock, unless a forked child still has a copy. The file is
            # truncated first, so that the note never names a process that has ended.
            file, self._file = self._file, None
            try:
                os.ftruncate(file, 0)
            except OSError:
                pass
            finally:
                os.close(file)

    def _open_locked(self) -> int | None:
        """The file, opened and locked; None if another process holds the lock."""
        while True:
            file = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o600)
            try:
                if not _try_lock(file):
                    os.close(file)
                    return None
                if self._is_still_there(file):
                    return file
            except BaseException:
                os.close(file)
                raise
            os.close(file)

    def _is_still_there(self, file: int) -> bool:
        """Whether the locked file still has its name (another process may have removed it between opening and
        locking)."""
        try:
            return os.path.samestat(os.fstat(file), os.stat(self.path))
        except FileNotFoundError:
            return False
