"""A list of erasures, kept beside the database: an older copy of the log that is put back must not bring back
what was erased since.

One line of JSON for each text: the lab, the reference, the position of the event that erased it. Without its
salt, which is gone, a reference tells nothing of the text. The list only grows; a torn last line is cut off.
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
    """What a list says. Raises BadInput for a file that is none."""
    try:
        lines = file.read_bytes().split(b"\n")
    except OSError as error:
        raise BadInput(
            f"{file} cannot be read: {error.strerror}.", remedy="Name a lab's labos.erased."
        ) from None
    for number, line in enumerate(lines[:-1], 1):  # what stands behind the last newline was cut off
        try:
            yield _decoder.decode(line)
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            raise BadInput(
                f"{file}:{number}: this is no line of a list of erasures ({error}).",
                remedy="Put back a copy of it, as it stands in a backup.",
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
