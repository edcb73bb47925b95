"""Backups: the log as sealed segments, with its blobs, in a folder; made while the lab runs.

The log only grows. So the records up to a position can be copied while the kernel continues to write; no
process waits. A second backup into the same folder adds a segment with the new records. A segment is never
changed. Its manifest in ``backup.json`` has its hashes, the hash of the state at its end, and a seal if a key
was given. People's words are in a separate file (``_words_copy``). The folder can be verified without a
database.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec

from labos.core.envelope import GENESIS, Record, check_chain
from labos.core.fold import evolve, fold_rows
from labos.core.registry import decode
from labos.core.seals import add_seal, check_seal
from labos.core.state import LabState, fold_fingerprint, from_picture, hash_state
from labos.errors import BadInput, LogDamaged, NotFound, Refused
from labos.private import make_folder, remove_leftovers, replace_file, tighten
from labos.store._blobs import FolderBlobs
from labos.store._event_store import SqlEventStore
from labos.store._objects import Blobs
from labos.store._segment import digest_file, read_segment, write_segment
from labos.store._words_copy import WordsExpected, copy_words

FORMAT = 1
MANIFEST = "backup.json"


_FILE = re.compile(r"\w[\w.-]*", re.ASCII)


class Segment(msgspec.Struct, frozen=True, omit_defaults=False):
    """A sealed part of the log. ``before`` and ``hash`` are the chain's hashes before it and at its end.
    ``state`` is the hash of the state at its end, computed by the fold code ``fold``. ``seal`` is empty if no
    key was given."""

    lab: str
    first: int
    last: int
    before: str
    hash: str
    recorded_at: int
    state: str
    fold: str
    file: str
    sha256: str
    seal: str = ""


class Backup(msgspec.Struct, frozen=True):
    """The content of ``backup.json``. ``epoch`` is the highest epoch of the log's kernels."""

    format: int
    lab: str
    epoch: int
    segments: tuple[Segment, ...]
    blobs: tuple[str, ...] = ()
    simulated: bool = False

    @property
    def position(self) -> int:
        return self.segments[-1].last if self.segments else 0

    @property
    def hash(self) -> str:
        return self.segments[-1].hash if self.segments else GENESIS.hex()


def backup(
    store: SqlEventStore,
    blobs: Blobs,
    folder: Path,
    *,
    key: bytes = b"",
    simulated: bool = False,
) -> Backup:
    """Extend a backup to the log's present end; returns the new content of the folder.

    Raises Refused if the folder holds another lab's backup or a backup that the log contradicts, LogDamaged
    (nothing is added), StoreUnavailable, BadInput.
    """
    head = store.head()
    if not head.position:
        raise Refused("The log is empty: there is nothing to back up.", remedy="Start the lab first.")
    known = read_backup(folder) if (folder / MANIFEST).exists() else None
    if known is not None:
        _refuse_other(known, store, head.lab, folder)
    elif folder.exists() and any(folder.iterdir()):
        raise Refused(f"{folder} holds other files.", remedy="Name a new folder, or one with a backup in it.")
    make_folder(folder)
    tighten([folder], "the backup's folder")
    remove_leftovers(folder, ".*.part")
    segments = known.segments if known else ()
    done = known.position if known else 0
    if head.position > done:
        before = bytes.fromhex(known.hash) if known else GENESIS
        name = f"log-{done + 1:09d}-{head.position:09d}.jsonl.gz"
        records = check_chain(store.read(done, head.position), before, done)
        digest, last = write_segment(folder / name, records)
        if last is None or last.head.position != head.position:
            ended = last.head.position if last is not None else done
            raise LogDamaged(
                f"The log ends at {ended}, but its head says {head.position}.",
                position=ended + 1,
                remedy="Find the first bad position with: labos verify",
            )
        segment = Segment(
            lab=str(head.lab),
            first=done + 1,
            last=head.position,
            before=before.hex(),
            hash=last.hash.hex(),
            recorded_at=last.head.recorded_at,
            state=hash_state(_fold_records(store, head.position)),
            fold=fold_fingerprint(),
            file=name,
            sha256=digest,
        )
        segments = (*segments, add_seal(segment, key))
    # Copied after the log: words and a blob are on disk before the event that refers to them.
    copy_words(store.all_words(), folder, head.position)
    copies = _copy_blobs(blobs, FolderBlobs(folder / "blobs"), set(known.blobs) if known else set())
    made = Backup(FORMAT, str(head.lab), head.epoch, segments, copies, simulated)
    replace_file(folder / MANIFEST, msgspec.json.format(msgspec.json.encode(made), indent=2) + b"\n")
    return made


def read_backup(folder: Path) -> Backup:
    """The content of a folder by its manifest. Raises BadInput."""
    try:
        found = msgspec.json.decode((folder / MANIFEST).read_bytes(), type=Backup)
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise BadInput(
            f"{folder} holds no backup ({error}).", remedy="Name a folder that labos backup has made."
        ) from None
    if found.format > FORMAT:
        raise BadInput(
            f"{folder} was written by a newer LabOS (format {found.format}; this one knows {FORMAT}).",
            remedy="Upgrade this installation: pip install --upgrade labos-sdl",
        )
    for segment in found.segments:
        # The name is used for reading and moving files beside the manifest.
        if not _FILE.fullmatch(segment.file):
            raise BadInput(
                f"The manifest of {folder} names {segment.file[:80]!r}, which is not a segment.",
                remedy="The manifest was changed: use another copy of the backup.",
            )
    return found


def records_of(folder: Path, found: Backup, archive: Path | None = None) -> Iterator[Record]:
    """The records of a backup, each checked against the chain and the manifests; segments that are not in its
    folder are read from the ``archive`` to which they were moved. Raises LogDamaged."""
    yield from read_stretch(folder, found.lab, found.segments, GENESIS, 0, archive)


def read_stretch(
    folder: Path,
    lab: str,
    segments: Sequence[Segment],
    before: bytes,
    after: int,
    archive: Path | None = None,
) -> Iterator[Record]:
    """The records of consecutive segments. The first segment begins after the position ``after`` with the
    hash ``before``. Each record is checked against the chain and the manifests. Raises LogDamaged."""
    for segment in segments:
        if segment.lab != lab:
            raise report_damage(segment, f"is of the lab {segment.lab}, and the backup is of {lab}")
        if (segment.first, segment.before) != (after + 1, before.hex()):
            raise report_damage(segment, "does not follow from the segment before")
        record = None
        path = find_segment(folder, segment, archive)
        for record in check_chain(_read_segment_of_lab(path, segment), before, after):
            yield record
        if record is None or (record.head.position, record.hash.hex()) != (segment.last, segment.hash):
            raise report_damage(segment, "does not end as its manifest states")
        before, after = record.hash, segment.last


def find_segment(folder: Path, segment: Segment, archive: Path | None) -> Path:
    """The file of a segment: in the backup's folder, or in the archive."""
    here = folder / segment.file
    return here if archive is None or here.is_file() else archive / segment.file


def _read_segment_of_lab(path: Path, segment: Segment) -> Iterator[Record]:
    """The records of a segment's file. The lab is checked before the chain."""
    for record in read_segment(path, segment.first - 1):
        if record.head.lab != segment.lab:
            raise report_damage(segment, f"holds a record of the lab {record.head.lab}")
        yield record


def verify_backup(folder: Path, *, key: bytes = b"", archive: Path | None = None) -> tuple[Backup, LabState]:
    """Check a backup without a database: seals, files, chain, fold and blobs. Returns the backup and its
    final state. Segments that are not in its folder are searched in the ``archive``. Raises LogDamaged,
    LogTooNew, BadInput."""
    found = read_backup(folder)
    check_manifests(folder, found.segments, key, archive)
    state, words = LabState(), WordsExpected(folder)
    ends = {segment.last: segment for segment in found.segments}
    for record in records_of(folder, found, archive):
        at = record.head
        words.take(record)
        try:
            evolve(state, decode(at.type, at.schema, record.payload), at.position, at.recorded_at)
        except (msgspec.MsgspecError, TypeError, KeyError, ValueError, IndexError) as error:
            raise LogDamaged(
                f"Position {at.position}: the record contradicts the log ({error}).",
                position=at.position,
                remedy="The records before it can be trusted.",
            ) from None
        end = ends.get(at.position)
        # Another version of LabOS may encode the same state differently.
        if end is not None and end.fold == fold_fingerprint() and end.state != hash_state(state):
            raise report_damage(end, "gives a different state than when it was sealed")
    words.end()
    check_files(folder, found.segments, archive)
    blobs = FolderBlobs(folder / "blobs")
    for name in found.blobs:
        try:
            blobs.get(name)
        except NotFound as error:
            raise LogDamaged(str(error), position=0, remedy="Use another copy of the backup.") from None
    return found, state


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
    """Check the segments of a backup from the first one that is in its folder; the segments before it are
    kept elsewhere, and no later segment may be missing.

    A segment's manifest has the hash of the chain before the segment. From there on the chain is checked as
    in a whole backup. This hash itself is not checked; a seal covers it too. A state cannot be folded from
    the middle of a log, so the hashes of states in the manifests are not checked. Raises LogDamaged,
    BadInput."""
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


def check_manifests(
    folder: Path, segments: Sequence[Segment], key: bytes, archive: Path | None = None
) -> None:
    """Check that all segments are there, and that their seals are correct if a key is given. Raises
    LogDamaged."""
    for segment in segments:
        if fault := check_seal(segment, key):
            raise report_damage(segment, f"cannot be trusted: {fault}")
        if not find_segment(folder, segment, archive).is_file():
            raise report_damage(segment, "is missing")


def check_files(folder: Path, segments: Sequence[Segment], archive: Path | None = None) -> None:
    """Check that the files of segments are identical to the sealed ones. Raises LogDamaged."""
    for segment in segments:
        if digest_file(find_segment(folder, segment, archive)) != segment.sha256:
            raise report_damage(segment, "is not the file that was sealed")


def report_damage(segment: Segment, why: str) -> LogDamaged:
    """The error for a segment that is damaged as a whole."""
    return LogDamaged(
        f"The segment {segment.file} (positions {segment.first} to {segment.last}) {why}.",
        position=segment.first,
        remedy="Use another copy of the backup; keep this one.",
    )


def _refuse_other(known: Backup, store: SqlEventStore, lab: str, folder: Path) -> None:
    if known.lab != lab:
        raise Refused(
            f"{folder} holds a backup of the lab {known.lab}; this one is {lab}.",
            remedy="Name another folder.",
        )
    record = next(store.read(known.position - 1, known.position), None)
    if record is None or record.hash.hex() != known.hash:
        raise Refused(
            f"{folder} reaches to position {known.position}, but this log is shorter, or differs "
            "before it: the log was cut, rewritten, or restored from an older backup.",
            remedy="Keep that folder, and name a new one.",
        )


def _fold_records(store: SqlEventStore, position: int) -> LabState:
    state = LabState()
    found = store.load_snapshot(fold_fingerprint())
    if found is not None and found[0] <= position:
        state = from_picture(found[2])
    fold_rows(state, store.replay(state.position, position))
    return state


def _copy_blobs(source: Blobs, target: FolderBlobs, done: set[str]) -> tuple[str, ...]:
    for name in source.names():
        if name not in done:
            target.put(source.get(name))
            done.add(name)
    return tuple(sorted(done))


def key_of(file: Path) -> bytes:
    """A key from a file: the SHA-256 of its bytes without white space at both ends. Raises BadInput."""
    try:
        text = file.read_bytes().strip()
    except OSError as error:
        raise BadInput(f"The key {file} cannot be read: {error.strerror}.", remedy="Name another.") from None
    if len(text) < 16:
        raise BadInput(
            f"The key {file} is too short ({len(text)} bytes).",
            remedy="Make one with: openssl rand -hex 32",
        )
    return hashlib.sha256(text).digest()
