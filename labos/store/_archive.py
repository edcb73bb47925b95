"""Moving old segments of a backup to their place for long-term storage.

A segment is copied, synced and read again before it is removed from the folder. So after an interruption it
is in at least one of the two places. The newest segment stays.
"""

from __future__ import annotations

from pathlib import Path

from labos.errors import LogDamaged, StoreUnavailable
from labos.private import make_folder, replace_file, sync_folder
from labos.store._backup import Segment, read_backup, report_damage
from labos.store._segment import digest_file


def move_old_segments(folder: Path, to: Path, before_ns: int) -> list[Segment]:
    """Move the segments whose newest event was recorded before a time (UTC ns); returns the moved ones.
    Raises LogDamaged for a segment that differs from the sealed one (it stays), StoreUnavailable,
    BadInput."""
    found = read_backup(folder)
    moved = []
    for segment in found.segments[:-1]:
        if segment.recorded_at >= before_ns:
            break  # later segments are newer
        source, target = folder / segment.file, to / segment.file
        if not source.is_file():
            continue  # it was moved before
        try:
            _move(segment, source, target)
        except OSError as error:
            raise StoreUnavailable(
                f"{segment.file} cannot be moved to {to}: {error.strerror or error}.",
                remedy="Check the free space, and that this user may write there. The segment is still in "
                "the backup.",
            ) from error
        moved.append(segment)
    return moved


def _move(segment: Segment, source: Path, target: Path) -> None:
    if digest_file(source) != segment.sha256:
        raise report_damage(segment, "has changed since it was sealed")
    make_folder(target.parent)
    if not target.is_file() or digest_file(target) != segment.sha256:
        replace_file(target, source.read_bytes())
    if digest_file(target) != segment.sha256:
        raise LogDamaged(
            f"{target} is not what was written there.",
            position=segment.first,
            remedy="Check that disk. The segment is still in the backup.",
        )
    source.unlink()
    sync_folder(source.parent)
