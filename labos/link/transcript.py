"""A transcript of every byte on every wire of this process, as text for people and for replay in tests. Each
line is one record with fields between tabs: seconds since the start, the link, a mark, the bytes. Marks:
``open``, ``close``, ``>`` sent, ``<`` received, ``!`` an error. Bytes that do not print are written as
``\\xNN``, ``\\r``, ``\\n``, ``\\t``; a backslash is doubled.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, TextIO

import msgspec

from labos.errors import BadInput

LARGEST = 256 * 1024 * 1024
"""The largest number of characters of a transcript, so that a forgotten one does not fill the disk."""

HEADER = "# labos transcript 1"
Mark = Literal["open", "close", ">", "<", "!"]
MARKS = ("open", "close", ">", "<", "!")

_ESCAPE = re.compile(r"\\(x[0-9a-fA-F]{2}|[tnr\\])")


class TranscriptLine(msgspec.Struct, frozen=True):
    """One line of a transcript."""

    at_s: float
    link: str
    mark: Mark
    data: bytes = b""


class _Recorder:
    def __init__(self, file: TextIO) -> None:
        self._file, self._began, self._size = file, time.monotonic(), 0
        self._lock = threading.Lock()
        print(HEADER, file=file, flush=True)

    def write(self, link: str, mark: Mark, data: bytes) -> None:
        with self._lock:
            if self._file.closed:
                return
            at = time.monotonic() - self._began
            self._size += self._file.write(f"{at:.6f}\t{link}\t{mark}\t{escape(data)}\n")
            if self._size > LARGEST:
                self._file.write(f"{at:.6f}\t{link}\t!\tthe transcript is full\n")
                self._file.close()
                return
            # A node that is killed must not lose the last received bytes.
            self._file.flush()

    def close(self) -> None:
        with self._lock:
            self._file.close()


_current: _Recorder | None = None


def start_recording(path: str | Path) -> None:
    """Record every byte of every link of this process from now on; an existing file is replaced. Raises
    BadInput."""
    global _current
    stop_recording()
    try:
        file = Path(path).open("w", encoding="ascii", newline="\n")  # noqa: SIM115 (it stays open)
    except OSError as error:
        raise BadInput(
            f"The transcript {path} cannot be written: {error.strerror}.", remedy="Name another file."
        ) from error
    _current = _Recorder(file)


def stop_recording() -> None:
    """Close the transcript, if there is one."""
    global _current
    if _current is not None:
        _current.close()
    _current = None


@contextmanager
def keep_transcript(path: str | Path) -> Iterator[None]:
    """Record a transcript for the duration of the block."""
    start_recording(path)
    try:
        yield
    finally:
        stop_recording()


def note(link: str, mark: Mark, data: bytes = b"") -> None:
    """Record an operation of a link, or bytes that it has received."""
    if _current is not None:
        _current.write(link, mark, data)


def read_transcript(path: str | Path) -> list[TranscriptLine]:
    """The lines of a transcript. Raises BadInput, with file and line."""
    lines = Path(path).read_text(encoding="ascii").splitlines()
    records = []
    for number, line in enumerate(lines, 1):
        if not line or line.startswith("#"):
            continue
        at, _, rest = line.partition("\t")
        link, _, rest = rest.partition("\t")
        mark, _, text = rest.partition("\t")
        try:
            if mark not in MARKS:
                raise ValueError(f"{mark!r} is not one of {', '.join(MARKS)}")
            records.append(TranscriptLine(float(at), link, mark, unescape(text)))  # type: ignore[arg-type]
        except ValueError as error:
            raise BadInput(
                f"{path}:{number}: not a line of a transcript: {error}.",
                remedy="Each line holds seconds, link, mark and bytes, with tabs between.",
            ) from error
    return records


def read_exchanges(script: str | Path | Iterable[TranscriptLine]) -> list[TranscriptLine]:
    """The sent and received bytes in a transcript. Raises BadInput."""
    lines = read_transcript(script) if isinstance(script, str | Path) else script
    return [line for line in lines if line.mark in "<>"]


def escape(data: bytes) -> str:
    """Bytes as printing ASCII."""
    return data.decode("latin-1").encode("unicode_escape").decode("ascii")


def unescape(text: str) -> bytes:
    """The bytes of such a text. Raises ValueError."""
    _, backslash, other = _ESCAPE.sub("", text).partition("\\")
    if backslash:  # Python knows more escapes
        raise ValueError(f"\\{other[:1]} stands for nothing")
    return text.encode("ascii").decode("unicode_escape").encode("latin-1")
