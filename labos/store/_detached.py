"""The later segments of a backup, checked without those before them, which may be kept elsewhere.

A segment's manifest says which hash the chain had in front of it. From there on the chain is checked as
in a whole backup; that the log before was what it was, the segment takes on trust. A seal covers that
hash too. Words that the segments refer to are checked as in a whole backup. A state cannot be folded from the
middle: it is as the manifests say, not as anybody checked.
"""

from __future__ import annotations

from pathlib import Path

import msgspec

from labos.core.envelope import GENESIS
from labos.errors import BadInput
from labos.store._backup import (
    Backup,
    Segment,
    check_files,
    check_manifests,
    read_backup,
    read_stretch,
    report_damage,
)
from labos.store._blobs import FolderBlobs
from labos.store._words_copy import WordsExpected


class Detached(msgspec.Struct, frozen=True):
    """What was checked (``segments``), what it rests on (``before``: the chain's hash at the position
    ``after``; ``sealed`` if a seal vouches for it), and what is not here. ``blobs`` counts those that were
    checked."""

    lab: str
    segments: tuple[Segment, ...]
    after: int
    before: str
    sealed: bool
    absent: tuple[Segment, ...]
    blobs: int
    blobs_absent: int

    @property
    def records(self) -> int:
        return self.segments[-1].last - self.after


def verify_detached(folder: Path, *, key: bytes = b"") -> Detached:
    """Check the segments of a backup from the first one on that is in its folder; none may be missing
    behind it. Raises LogDamaged, BadInput."""
    found = read_backup(folder)
    there = [(folder / segment.file).is_file() for segment in found.segments]
    if not any(there):
        raise BadInput(
            f"None of the segments of {folder} is there.", remedy="Put one back, or name another folder."
        )
    first = there.index(True)
    absent, segments = found.segments[:first], found.segments[first:]
    check_manifests(folder, segments, key)
    before, after = segments[0].before, segments[0].first - 1
    try:
        rests_on = bytes.fromhex(before) if after else GENESIS
    except ValueError:
        raise report_damage(segments[0], "names no hash that it rests on") from None
    words = WordsExpected(folder)
    for record in read_stretch(folder, found.lab, segments, rests_on, after):
        words.take(record)
    words.end()
    check_files(folder, segments)
    checked, missing = _count_blobs(folder, found)
    return Detached(found.lab, segments, after, before, bool(key), absent, checked, missing)


def _count_blobs(folder: Path, found: Backup) -> tuple[int, int]:
    """How many blobs are there and good, and how many are not there. Raises LogDamaged."""
    blobs = FolderBlobs(folder / "blobs")
    here = set(found.blobs).intersection(blobs.names())
    for name in here:
        blobs.get(name)
    return len(here), len(found.blobs) - len(here)
