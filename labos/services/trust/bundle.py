"""A bundle: a run, an experiment or a campaign as a file, with its proof for readers who have the lab's
public key.

A zip file. Each part is checked: events are in the tree whose root is signed, payloads and files have the
digests that the events name.

===================  ========================================================================
``bundle.json``      what it is and from which lab (for people; it is checked against the events)
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
from collections.abc import Container, Iterable, Iterator
from pathlib import Path

import msgspec

from labos.core.envelope import Record
from labos.core.merkle import Tree, hash_leaf, list_inclusion_ranges, make_proof
from labos.core.plans import PlanRecorded, PlanStepsRecorded
from labos.core.runs import RunSubmitted
from labos.core.words import list_references
from labos.errors import LogDamaged, NotFound, Refused
from labos.ports import BlobStore
from labos.services.log import Log
from labos.services.signatures import ENDS, SIGNED, Kind, find_kind_in, list_runs
from labos.services.trust.checkpoints import TreeHead, parse_tree_head
from labos.services.trust.keys import encode_rotations
from labos.services.trust.notes import Note
from labos.services.verification import find_needed_blobs

FORMAT = "labos-bundle/1"
"""The format of a run's bundle without words; the second one is for an experiment or a campaign, the third
one for bundles with words."""
FORMAT_OF_SEVERAL, WITH_WORDS = "labos-bundle/2", "labos-bundle/3"
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


class AboutBundle(msgspec.Struct, frozen=True):
    """The description in a bundle. ``subject`` is the run, experiment or campaign, and ``kind`` says which of
    these it is; ``runs`` are the runs of an experiment or a campaign. The bundle of a run also has its
    ``run``, as in the first format."""

    format: str
    lab: str
    size: int
    events: int
    blobs: int
    run: str = ""
    kind: Kind = "run"
    subject: str = ""
    runs: tuple[str, ...] = ()

    @property
    def of(self) -> str:
        """The run, experiment or campaign."""
        return self.subject or self.run


class ProvenEvent(msgspec.Struct, frozen=True):
    """A line of ``events.jsonl``: the bytes as stored, and the hashes of the proof as hexadecimal digits."""

    envelope: msgspec.Raw
    payload: msgspec.Raw
    proof: tuple[str, ...]


class WordsLine(msgspec.Struct, frozen=True):
    """A line of ``words.jsonl``: a text and its salt (hexadecimal digits). An event holds the digest of
    both."""

    reference: str
    salt: str
    text: str


class Attachments(msgspec.Struct, frozen=True):
    """The parts of a bundle that are not in the log: the checkpoint, its time stamp, rotations of the key;
    and whether people's words are included."""

    note: Note
    stamp: bytes = b""
    rotations: tuple[Note, ...] = ()
    words: bool = True


def make_bundle(log: Log, blobs: BlobStore, subject: str, beside: Attachments) -> tuple[bytes, AboutBundle]:
    """The bundle of a run, an experiment or a campaign that had ended at the checkpoint. Raises NotFound for
    an unknown one or a missing blob, Refused if it had not ended, LogDamaged if the checkpoint is not of this
    log."""
    head = parse_tree_head(beside.note.text)
    tree, records, runs = _read(log, subject, head)
    kind = find_kind_in(record for record in records if record.head.stream == subject)
    if kind is None:
        raise NotFound(
            f"There is no run, experiment or campaign {subject!r} in this log up to position {head.size}.",
            remedy="labos runs --all",
        )
    last = {record.head.type for record in records if record.head.stream == subject}
    if last.isdisjoint(ENDS[kind]):
        raise Refused(
            f"The {kind} {subject} has not ended, so a missing record could not be distinguished from "
            "a removed one.",
            remedy="Wait for its end, then make a checkpoint.",
        )
    lines = []
    digests: dict[str, None] = {}
    for record in records:
        index = record.head.position - 1
        proof = make_proof(list_inclusion_ranges(index, tree.size), tree.hash_of)
        line = ProvenEvent(
            msgspec.Raw(record.envelope), msgspec.Raw(record.payload), tuple(each.hex() for each in proof)
        )
        lines.append(msgspec.json.encode(line) + b"\n")
        digests.update(dict.fromkeys(find_needed_blobs(record.head.type, record.payload)))
    words = _encode_words(log, records) if beside.words else b""
    about = AboutBundle(
        WITH_WORDS if words else FORMAT if kind == "run" else FORMAT_OF_SEVERAL,
        records[0].head.lab,
        head.size,
        len(records),
        len(digests),
        run=subject if kind == "run" else "",
        kind=kind,
        subject=subject,
        runs=runs,
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


def _encode_words(log: Log, records: Iterable[Record]) -> bytes:
    """The words in records that have not been erased."""
    named = dict.fromkeys(name for record in records for name in list_references(record.payload))
    found = log.words_of(named) if named else {}
    standing = [found[name] for name in named if name in found and not found[name].is_erased]
    return b"".join(
        msgspec.json.encode(WordsLine(kept.reference, kept.salt.hex(), kept.text)) + b"\n"
        for kept in standing
    )


def _read(log: Log, subject: str, head: TreeHead) -> tuple[Tree, list[Record], tuple[str, ...]]:
    """The tree of a checkpoint, the records of a bundle, and the runs. The records are: the stream of the
    subject, those of its runs, the signatures for any of them, and plans that are in other streams."""
    found: dict[int, Record] = {}
    plans: dict[str, list[Record]] = {}
    runs = dict.fromkeys(list_runs(log, subject, head.size))
    hashes = []
    for record in log.read(0, head.size):
        hashes.append(hash_leaf(record.envelope))
        kind, stream = record.head.type, record.head.stream
        if kind in PLANS:
            plans.setdefault(stream, []).append(record)
        if stream == subject or stream in runs or is_signature(kind, record.payload, {subject, *runs}):
            found[record.head.position] = record
    tree = Tree(hashes)
    if tree.size != head.size or tree.compute_root() != head.root:
        raise LogDamaged(
            f"The log is not the one whose checkpoint of size {head.size} was signed.",
            position=tree.size,
            remedy="Check with labos verify --checkpoint FILE.",
        )
    for name in tuple(list_plan_streams(found.values())):
        found |= {record.head.position: record for record in plans.get(name, ())}
    return tree, [found[position] for position in sorted(found)], tuple(runs)


def belongs_to(submission: bytes, subject: str) -> bool:
    """Whether a submitted run belongs to an experiment or a campaign."""
    found = msgspec.json.decode(submission)
    return subject in (found.get("experiment"), found.get("campaign"))


def is_signature(kind: str, payload: bytes, names: Container[str]) -> bool:
    """Whether an event is a signature for one of these names."""
    if kind not in SIGNED:
        return False
    found = msgspec.json.decode(payload)
    return (found.get("run") or found.get("subject")) in names


def list_plan_streams(records: Iterable[Record]) -> Iterator[str]:
    """The streams with the plans of submitted runs, besides the runs' own streams."""
    for record in records:
        if record.head.type == RunSubmitted.TYPE:
            name = msgspec.json.decode(record.payload).get("planned_by", "")
            if name:
                yield str(name)


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
    """A checkpoint file and the time stamp beside it, if there is one. Raises OSError."""
    stamp = path.with_suffix(".tsr")
    return path.read_bytes(), stamp.read_bytes() if stamp.exists() else b""
