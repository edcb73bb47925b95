"""A check of the later segments of a backup, if the segments before them are kept elsewhere.

A segment's manifest has the hash of the chain before the segment. From there on the chain is checked as in a
whole backup. This hash itself is not checked; a seal covers it too. Words to which the segments refer are
checked as in a whole backup. A state cannot be folded from the middle of a log, so the hashes of states in
the manifests are not checked.
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
    """The result: the checked ``segments``, the hash ``before`` that was not checked (of the chain at the
    position ``after``; ``sealed`` if a seal covers it), and the missing parts. ``blobs`` counts the checked
    blobs."""

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
    """Check the segments of a backup from the first one that is in its folder; no later segment may be
    missing. Raises LogDamaged, BadInput."""
    found = read_backup(folder)
    there = [(folder / segment.file).is_file() for segment in found.segments]
    if not any(there):
        raise BadInput(
            f"All segments of {folder} are missing.", remedy="Put one back, or name another folder."
        )
    first = there.index(True)
    absent, segments = found.segments[:first], found.segments[first:]
    check_manifests(folder, segments, key)
    before, after = segments[0].before, segments[0].first - 1
    try:
        rests_on = bytes.fromhex(before) if after else GENESIS
    except ValueError:
        raise report_damage(segments[0], "names no hash of the record before it") from None
    words = WordsExpected(folder)
    for record in read_stretch(folder, found.lab, segments, rests_on, after):
        words.take(record)
    words.end()
    check_files(folder, segments)
    checked, missing = _count_blobs(folder, found)
    return Detached(found.lab, segments, after, before, bool(key), absent, checked, missing)


def _count_blobs(folder: Path, found: Backup) -> tuple[int, int]:
    """The number of blobs that are there and correct, and the number of missing ones. Raises LogDamaged."""
    blobs = FolderBlobs(folder / "blobs")
    here = set(found.blobs).intersection(blobs.names())
    for name in here:
        blobs.get(name)
    return len(here), len(found.blobs) - len(here)
