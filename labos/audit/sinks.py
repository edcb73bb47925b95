"""Exports events to a file of JSON lines, which itself contains the position. Each line is a CloudEvent with
its position. The export continues after the last complete line, so that position and events always agree; an
incomplete line after a crash is written again.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO

import msgspec

from labos.audit.cloudevents import encode_cloudevent
from labos.core.envelope import Record
from labos.errors import BadInput, SystemFailed
from labos.private import FILE

BEGIN = b'{"specversion":"1.0",'
"""How every line begins."""
CHUNK = 64 * 1024
REMEDY = "Name a file that does not exist yet."


class _Line(msgspec.Struct):
    """The fields that are read of an existing line."""

    source: str
    position: str


class JsonLines:
    """A file with one line for each event, in order; ``position`` is the position of the last event in it.
    Only one process at a time may write it."""

    def __init__(self, path: Path) -> None:
        """Raises BadInput for a file with other content, or one that another process is writing;
        SystemFailed."""
        self._path = path
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), FILE)
            self._file: BinaryIO = os.fdopen(handle, "r+b")
        except OSError as error:
            raise SystemFailed(f"{path} cannot be written: {error.strerror}.") from None
        try:
            self._lock()
            self.position, self.source = self._find_end()
        except BaseException:
            self._file.close()
            raise

    def write(self, records: Iterable[Record]) -> None:
        """Append records; on return they are synced. Raises SystemFailed, and BadInput for records of another
        log."""
        try:
            for record in records:
                line = encode_cloudevent(record)
                source = msgspec.json.decode(line, type=_Line).source
                if self.source not in ("", source):
                    raise BadInput(f"{self._path} contains the events of another lab.", remedy=REMEDY)
                self._file.write(line + b"\n")
                self.position, self.source = record.head.position, source
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise SystemFailed(f"{self._path} cannot be written: {error.strerror}.") from None

    def close(self) -> None:
        self._file.close()

    def _lock(self) -> None:
        try:
            import fcntl
        except ImportError:
            return  # Windows
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise BadInput(f"Another process is writing {self._path}.", remedy="End that process.") from None

    def _find_end(self) -> tuple[int, str]:
        """Position and source of the last complete line; the rest after it is cut off."""
        end = self._find_last_newline(self._file.seek(0, os.SEEK_END))
        begin = self._find_last_newline(end - 1) if end else 0
        self._file.seek(begin)
        line = self._file.read(end - begin)
        try:
            last = msgspec.json.decode(line, type=_Line) if line else _Line("", "0")
            found = int(last.position), last.source
        except (msgspec.MsgspecError, ValueError):
            raise BadInput(f"{self._path} contains something other than events.", remedy=REMEDY) from None
        self._file.seek(0)
        if not end and not BEGIN.startswith(self._file.read(len(BEGIN))):
            raise BadInput(f"{self._path} contains something other than events.", remedy=REMEDY)
        self._file.truncate(end)
        self._file.seek(end)
        return found

    def _find_last_newline(self, before: int) -> int:
        """The byte after the last newline among the first ``before`` bytes; 0 if there is none."""
        while before > 0:
            begin = max(before - CHUNK, 0)
            self._file.seek(begin)
            found = self._file.read(before - begin).rfind(b"\n")
            if found >= 0:
                return begin + found + 1
            before = begin
        return 0
