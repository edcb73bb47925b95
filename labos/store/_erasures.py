"""A list of erasures, stored beside the database: a restored older copy of the log must not bring erased
words back.

There is one line of JSON for each text: the lab, the reference, and the position of the event that erased it.
Its salt is deleted, and without the salt nothing can be learned from a reference. The list only grows; a torn
last line is cut off.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import msgspec
import structlog

from labos.errors import BadInput
from labos.private import FILE, sync_folder

ERASURES = "labos.erased"

_log = structlog.get_logger(__name__)


class Erased(msgspec.Struct, frozen=True):
    """A text of a lab that an event at a position erased."""

    lab: str
    reference: str
    position: int


_decoder = msgspec.json.Decoder(Erased)


def read_erasures(file: Path) -> Iterator[Erased]:
    """The entries of a list. Raises BadInput for a file that is not such a list."""
    try:
        lines = file.read_bytes().split(b"\n")
    except OSError as error:
        raise BadInput(
            f"{file} cannot be read: {error.strerror}.", remedy="Name a lab's labos.erased."
        ) from None
    for number, line in enumerate(lines[:-1], 1):  # bytes after the last newline are a torn line
        try:
            yield _decoder.decode(line)
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            raise BadInput(
                f"{file}:{number}: this is not a line of a list of erasures ({error}).",
                remedy="Replace it with the copy from a backup.",
            ) from None


def add_erasures(file: Path, erased: Iterable[Erased]) -> None:
    """Append to a list; on return it is synced. Raises OSError."""
    lines = b"".join(msgspec.json.encode(each) + b"\n" for each in erased)
    if not lines:
        return
    is_new = not file.exists()
    handle = os.open(file, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), FILE)
    with os.fdopen(handle, "r+b") as written:
        end = written.seek(0, os.SEEK_END)
        written.seek(0)
        whole = written.read(end).rfind(b"\n") + 1
        written.truncate(whole)
        written.seek(whole)
        written.write(lines)
        written.flush()
        os.fsync(written.fileno())
    if is_new:
        sync_folder(file.parent)
