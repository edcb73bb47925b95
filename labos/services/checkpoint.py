"""Checkpoints: the position and hash of the log's end, kept elsewhere. With them a log that was cut off or
rewritten is detected."""

from __future__ import annotations

from pathlib import Path

import msgspec

from labos.errors import BadInput
from labos.services.log import Log
from labos.services.times import iso_time


class Checkpoint(msgspec.Struct, frozen=True, omit_defaults=True):
    """The end of a log at a time; ``hash`` as hexadecimal digits. ``seal`` is empty if no key was given when
    the checkpoint was written."""

    lab: str
    position: int
    hash: str
    time: str
    seal: str = ""


def make_checkpoint(log: Log) -> Checkpoint:
    """A checkpoint of the log's present end."""
    head = log.head()
    return Checkpoint(head.lab, head.position, head.hash.hex(), iso_time(head.recorded_at))


def read_checkpoint(path: Path) -> Checkpoint:
    """Raises BadInput if the file cannot be read as a checkpoint."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=Checkpoint)
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise BadInput(
            f"{path} is not a checkpoint ({error}).", remedy="Name one that labos verify has written."
        ) from None


def find_contradiction(log: Log, seen: Checkpoint) -> str:
    """How the log contradicts a checkpoint, in one sentence; empty if it does not."""
    head = log.head()
    if head.lab != seen.lab:
        return f"the checkpoint is of the lab {seen.lab}, the log of {head.lab or 'none'}"
    if head.position < seen.position:
        return (
            f"the log ends at position {head.position}, but at {seen.time} it reached {seen.position}: "
            "its tail was cut off"
        )
    if not seen.position:
        return ""
    record = next(log.read(seen.position - 1, seen.position), None)
    if record is None or record.hash.hex() != seen.hash:
        return (
            f"position {seen.position} has another hash than at {seen.time}: the log up to there was "
            "rewritten"
        )
    return ""
