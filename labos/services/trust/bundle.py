"""A bundle: one run as a file, with all that proves it to whoever has the lab's public key.

A zip file. Nothing in it is believed for itself: events are in the tree whose root is signed, payloads and
files have the digests that the events name.

===================  ========================================================================
``bundle.json``      which run of which lab (for people; it is checked against the events)
``checkpoint.note``  the signed root
``checkpoint.tsr``   its time stamp, if there is one
``rotation.notes``   changes of the lab's key, if there were any
``events.jsonl``     an event a line: envelope and payload as stored, and the proof of inclusion
``words.jsonl``      what people wrote into them, if it was not erased or left out
``blobs/…``          files that the events name, by SHA-256
===================  ========================================================================
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterable
from pathlib import Path

import msgspec

from labos.core.envelope import Record
from labos.core.merkle import Tree, inclusion_ranges, leaf_hash, proof_of
from labos.core.plans import PlanRecorded, PlanStepsRecorded
from labos.core.runs import RUN_ENDS, RunSubmitted
from labos.core.signatures import RunSigned
from labos.core.words import references_in
from labos.errors import LogDamaged, NotFound, Refused
from labos.ports import BlobStore
from labos.services.log import Log
from labos.services.trust.checkpoints import TreeHead, parse_tree_head
from labos.services.trust.keys import encode_rotations
from labos.services.trust.notes import Note
from labos.services.verification import needed_blobs

FORMAT, WITH_WORDS = "labos-bundle/1", "labos-bundle/2"
"""Of a bundle without and with words."""
SIGNED = RunSigned.TYPE
PLANS = (PlanRecorded.TYPE, PlanStepsRecorded.TYPE)
ABOUT, NOTE, STAMP, ROTATIONS, EVENTS = (
    "bundle.json",
    "checkpoint.note",
    "checkpoint.tsr",
    "rotation.notes",
    "events.jsonl",
)
WORDS = "words.jsonl"
BLOBS = "blobs/"


class About(msgspec.Struct, frozen=True):
    """What a bundle says of itself."""

    format: str
    lab: str
    run: str
    size: int
    events: int
    blobs: int


class ProvenEvent(msgspec.Struct, frozen=True):
    """A line of ``events.jsonl``: bytes as they are stored, and the hashes of the proof as hexadecimal
    digits."""

    envelope: msgspec.Raw
    payload: msgspec.Raw
    proof: tuple[str, ...]


class ToldWords(msgspec.Struct, frozen=True):
    """A line of ``words.jsonl``: a text, and the salt (hexadecimal digits) with which its digest stands in an
    event."""

    reference: str
    salt: str
    text: str


class Attachments(msgspec.Struct, frozen=True):
    """What goes into a bundle beside the log: the checkpoint, its time stamp, changes of the key; and whether
    what people wrote does."""

    note: Note
    stamp: bytes = b""
    rotations: tuple[Note, ...] = ()
    words: bool = True


def make_bundle(log: Log, blobs: BlobStore, run: str, beside: Attachments) -> tuple[bytes, About]:
    """The bundle of a run that had ended at a checkpoint. Raises NotFound for an unknown run or a blob that
    is not there, Refused if it had not ended, LogDamaged if the log is not the one of the checkpoint."""
    head = parse_tree_head(beside.note.text)
    tree, records = _read(log, run, head)
    if not records:
        raise NotFound(
            f"There is no run {run!r} in this log up to position {head.size}.", remedy="labos runs --all"
        )
    last = [record.head.type for record in records if record.head.stream == run]
    if not any(kind in RUN_ENDS for kind in last):
        raise Refused(
            f"The run {run} has not ended: what is missing could not be told from what was taken away.",
            remedy="Wait for its end, then make a checkpoint.",
        )
    lines = []
    digests: dict[str, None] = {}
    for record in records:
        index = record.head.position - 1
        proof = proof_of(inclusion_ranges(index, tree.size), tree.hash_of)
        line = ProvenEvent(
            msgspec.Raw(record.envelope), msgspec.Raw(record.payload), tuple(each.hex() for each in proof)
        )
        lines.append(msgspec.json.encode(line) + b"\n")
        digests.update(dict.fromkeys(needed_blobs(record.head.type, record.payload)))
    words = _words(log, records) if beside.words else b""
    about = About(
        WITH_WORDS if words else FORMAT, records[0].head.lab, run, head.size, len(records), len(digests)
    )
    files = {
        ABOUT: msgspec.json.format(msgspec.json.encode(about), indent=2) + b"\n",
        NOTE: beside.note.encode(),
        **({STAMP: beside.stamp} if beside.stamp else {}),
        **({ROTATIONS: encode_rotations(beside.rotations)} if beside.rotations else {}),
        EVENTS: b"".join(lines),
        **({WORDS: words} if words else {}),
        **{f"{BLOBS}{digest}": blobs.get(digest) for digest in digests},
    }
    return _pack(files), about


def _words(log: Log, records: Iterable[Record]) -> bytes:
    """What people wrote into records, as far as it was not erased."""
    named = dict.fromkeys(name for record in records for name in references_in(record.payload))
    found = log.words_of(named) if named else {}
    standing = [found[name] for name in named if name in found and not found[name].is_erased]
    return b"".join(
        msgspec.json.encode(ToldWords(kept.reference, kept.salt.hex(), kept.text)) + b"\n"
        for kept in standing
    )


def _read(log: Log, run: str, head: TreeHead) -> tuple[Tree, list[Record]]:
    """The tree of a checkpoint, and the records of a run: its stream, and its plan where that stands in
    another one."""
    found: list[Record] = []
    plans: dict[str, list[Record]] = {}
    hashes = []
    for record in log.read(0, head.size):
        hashes.append(leaf_hash(record.envelope))
        if record.head.type in PLANS:
            plans.setdefault(record.head.stream, []).append(record)
        if record.head.stream == run or signs(record.head.type, record.payload, run):
            found.append(record)
    tree = Tree(hashes)
    if tree.size != head.size or tree.root() != head.root:
        raise LogDamaged(
            f"The log is not the one whose checkpoint of size {head.size} was signed.",
            position=tree.size,
            remedy="Look with labos verify --checkpoint FILE.",
        )
    return tree, sorted(
        {record.head.position: record for record in (*found, *_plan(found, plans))}.values(),
        key=lambda record: record.head.position,
    )


def signs(kind: str, payload: bytes, run: str) -> bool:
    """Whether an event is a signature under a run."""
    return kind == SIGNED and msgspec.json.decode(payload).get("run") == run


def _plan(records: Iterable[Record], plans: dict[str, list[Record]]) -> list[Record]:
    for record in records:
        if record.head.type == RunSubmitted.TYPE:
            planned_by = msgspec.json.decode(record.payload).get("planned_by", "")
            return plans.get(planned_by, [])
    return []


def _pack(files: dict[str, bytes]) -> bytes:
    """The same files give the same bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o600 << 16
            archive.writestr(entry, data)
    return buffer.getvalue()


def note_beside(path: Path) -> tuple[bytes, bytes]:
    """A checkpoint's file and the time stamp beside it, if there is one. Raises OSError."""
    stamp = path.with_suffix(".tsr")
    return path.read_bytes(), stamp.read_bytes() if stamp.exists() else b""
