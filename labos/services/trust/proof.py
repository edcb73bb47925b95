"""Checks a bundle offline: only the lab's public key is needed."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec

from labos.core.campaigns import CampaignCompleted
from labos.core.canonical import digest
from labos.core.envelope import Envelope, Record
from labos.core.merkle import hash_leaf, is_included
from labos.core.runs import RunSubmitted
from labos.core.signatures import RecordsSigned, RunSigned, make_digest_of_records
from labos.core.words import Kept, list_references
from labos.errors import BadInput
from labos.services.signatures import BEGINS, ENDS, Kind
from labos.services.times import iso_time
from labos.services.trust.bundle import (
    ABOUT,
    BLOBS,
    EVENTS,
    FORMAT,
    FORMAT_OF_SEVERAL,
    NOTE,
    PLANS,
    ROTATIONS,
    STAMP,
    WITH_WORDS,
    WORDS,
    AboutBundle,
    ProvenEvent,
    WordsLine,
    belongs_to,
    is_signature,
    list_plan_streams,
)
from labos.services.trust.checkpoints import TreeHead, parse_tree_head
from labos.services.trust.keys import TrustedKeys, parse_rotations
from labos.services.trust.notes import Note, PublicKey, parse_note
from labos.services.trust.timestamp import read_stamp_time
from labos.services.verification import Fault, VerifiedPart, find_needed_blobs

LARGEST = 4 << 30
"""The largest total size in bytes of a bundle's unpacked files."""

_line = msgspec.json.Decoder(ProvenEvent)
_envelope = msgspec.json.Decoder(Envelope)
_words_decoder = msgspec.json.Decoder(WordsLine)
_about = msgspec.json.Decoder(AboutBundle)


class Trust(msgspec.Struct, frozen=True):
    """The keys that the reader of a bundle trusts: public keys of labs, of witnesses (each must have
    cosigned), and the certificates of time stamp authorities (a PEM file)."""

    keys: tuple[PublicKey, ...]
    witnesses: tuple[PublicKey, ...] = ()
    authorities: Path | None = None


class BundleProof(msgspec.Struct, frozen=True):
    """The result of the check of a bundle, part by part. ``subject`` (a run, experiment or campaign:
    ``kind``) and ``lab`` are those of the proven events; ``run`` is the same as ``subject`` for a run, else
    empty."""

    run: str
    kind: Kind
    subject: str
    lab: str
    size: int
    signed_by: str
    parts: tuple[VerifiedPart, ...]

    @property
    def faults(self) -> list[str]:
        return [fault for part in self.parts for fault in part.faults]


def prove_bundle(path: Path, trust: Trust) -> BundleProof:
    """Check a bundle. Raises BadInput for a file that is not a bundle."""
    files = _unpack(path)
    about = _read_about(files, path)
    note = parse_note(files[NOTE])
    head = parse_tree_head(note.text)
    signed, signer = _check_signature(files, note, head, trust)
    inside, events = _check_events(files, head)
    parts = [
        signed,
        *_check_witnesses(note, trust),
        *_check_stamp(files, note, trust),
        inside,
        _check_story(about, events),
        *_check_signatures(about, events),
        *_check_words(files, events),
        _check_blobs(files, events),
    ]
    lab = events[0].head.lab if events else ""
    return BundleProof(about.run, about.kind, about.of, lab, head.size, signer, tuple(parts))


def _unpack(path: Path) -> dict[str, bytes]:
    try:
        with zipfile.ZipFile(io.BytesIO(path.read_bytes())) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > LARGEST:
                raise ValueError(f"it unpacks to more than {LARGEST} bytes")
            names = archive.namelist()
            if len(set(names)) != len(names):
                raise ValueError("it contains a name twice")
            return {name: archive.read(name) for name in names}
    except (OSError, ValueError, zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
        raise _make_bundle_error(path, str(error)) from None
    except Exception as error:  # zlib.error, EOFError, struct.error and other errors of damaged bytes
        raise _make_bundle_error(path, f"it cannot be unpacked ({error})") from None


def _read_about(files: dict[str, bytes], path: Path) -> AboutBundle:
    missing = [name for name in (ABOUT, NOTE, EVENTS) if name not in files]
    if missing:
        raise _make_bundle_error(path, f"these files are missing: {', '.join(missing)}")
    try:
        about = _about.decode(files[ABOUT])
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise _make_bundle_error(path, f"{ABOUT}: {error}") from None
    if about.format not in (FORMAT if about.kind == "run" else FORMAT_OF_SEVERAL, WITH_WORDS):
        raise BadInput(
            f"{path} has the format {about.format!r}, which this LabOS does not know.",
            remedy="Check it with the LabOS that made it.",
        )
    return about


def _check_signature(
    files: dict[str, bytes], note: Note, head: TreeHead, trust: Trust
) -> tuple[VerifiedPart, str]:
    try:
        known = TrustedKeys(trust.keys, parse_rotations(files.get(ROTATIONS, b"")))
        signers = known.find_signers(note, head)
    except BadInput as error:
        return VerifiedPart("signature", 1, error.message, (str(error),)), ""
    if not known.list_for(head.origin):
        fault = f"The checkpoint is of {head.origin}, but no key with this name was given."
        return VerifiedPart.fail("signature", 1, fault), ""
    if not signers:
        by = ", ".join(f"{each.name} ({each.key_id.hex()})" for each in note.signatures)
        fault = f"No key that was given has signed the checkpoint; it is signed by {by}."
        return VerifiedPart.fail("signature", 1, fault), ""
    signer = signers[-1]
    by_way = "" if signer in trust.keys else ", the successor of the key that was given"
    result = f"The checkpoint of size {head.size} is signed by {signer.name} ({signer.id.hex()}){by_way}."
    return VerifiedPart("signature", 1, result), signer.text


def _check_witnesses(note: Note, trust: Trust) -> Iterator[VerifiedPart]:
    for key in trust.witnesses:
        try:
            cosigned = bool(note.find_signers([key]))
        except BadInput:
            cosigned = False
        if cosigned:
            at = next(each.time_s for each in note.signatures if each.is_by(key))
            yield VerifiedPart("witness", 1, f"The witness {key.name} cosigned it at {iso_time(at * 10**9)}.")
        else:
            yield VerifiedPart.fail("witness", 1, f"The witness {key.name} has not cosigned the checkpoint.")


def _check_stamp(files: dict[str, bytes], note: Note, trust: Trust) -> Iterator[VerifiedPart]:
    stamp = files.get(STAMP)
    if trust.authorities is None:
        if stamp is not None:
            yield VerifiedPart("time stamp", 0, "There is a time stamp; it was not checked (--tsa FILE).")
    elif stamp is None:
        yield VerifiedPart.fail("time stamp", 0, "The checkpoint has no time stamp.")
    else:
        try:
            at = read_stamp_time(stamp, note.text.encode(), trust.authorities)
            yield VerifiedPart(
                "time stamp", 1, f"By its time stamp, the checkpoint existed at {at.isoformat()}."
            )
        except BadInput as error:
            yield VerifiedPart("time stamp", 1, error.message, (str(error),))


def _check_events(files: dict[str, bytes], head: TreeHead) -> tuple[VerifiedPart, list[Record]]:
    """Whether each event is in the tree and has its payload. Events that are not are left out of the later
    checks."""
    good: list[Record] = []
    faults: list[Fault] = []
    lines = files[EVENTS].splitlines()
    for number, line in enumerate(lines, 1):
        try:
            found = _line.decode(line)
            envelope = bytes(found.envelope)
            # The hashes of the chain are not in a bundle: the tree is the proof.
            event = Record(_envelope.decode(envelope), envelope, bytes(found.payload), b"")
            proof = [bytes.fromhex(each) for each in found.proof]
        except (msgspec.MsgspecError, ValueError) as error:
            faults.append((f"Line {number} of {EVENTS} cannot be read ({error}).", None))
            continue
        at = event.head.position
        if not is_included(hash_leaf(envelope), at - 1, head.size, head.root, proof):
            faults.append((f"Position {at}: the event is not in the log that was signed.", at))
        elif digest(event.payload) != event.head.digest:
            fault = f"Position {at}: the payload of {event.head.type} was changed after it was recorded."
            faults.append((fault, at))
        else:
            good.append(event)
    result = f"{len(good)} of {len(lines)} events are in the log that was signed."
    return VerifiedPart.sum_up("events", len(lines), result, faults), good


def _check_story(about: AboutBundle, events: Sequence[Record]) -> VerifiedPart:
    """Whether these are all events of the bundle's subject and of its runs, each from its beginning to its
    end."""
    streams = {about.of: about.kind, **dict.fromkeys(about.runs, "run")}
    faults: list[Fault] = []
    if len({event.head.lab for event in events} | {about.lab}) > 1:
        faults.append(("The events are from several labs, or not from the lab of the bundle.", None))
    if [event.head.position for event in events] != sorted({event.head.position for event in events}):
        faults.append(("The events are not in the order of the log.", None))
    by_stream: dict[str, list[Record]] = {name: [] for name in streams}
    for event in events:
        by_stream.get(event.head.stream, []).append(event)
    for name, own in by_stream.items():
        faults += _list_gaps(name, streams[name], own)
        if name != about.of and not any(_is_submission(event, about.of) for event in own):
            faults.append((f"The run {name} does not belong to {about.of}.", None))
    own = [event for event in events if event.head.stream in streams]
    planned = set(list_plan_streams(own))
    for event in events:
        is_plan = event.head.type in PLANS and event.head.stream in planned
        if event.head.stream in streams or is_plan or is_signature(event.head.type, event.payload, streams):
            continue
        at = event.head.position
        faults.append((f"Position {at}: {event.head.type} does not belong to {about.of}.", at))
    if about.kind == "campaign":
        faults += _find_missing_rows(about, by_stream[about.of])
    return VerifiedPart.sum_up(about.kind, len(own), _describe_story(about, len(own)), faults)


def _describe_story(about: AboutBundle, own: int) -> str:
    if about.kind == "run":
        return f"The run {about.of} is complete: its {own} events, from its submission to its end."
    runs = f"{len(about.runs)} run{'' if len(about.runs) == 1 else 's'}"
    whole = f"The {about.kind} {about.of} is complete: {own} events, with those of its {runs}."
    # The events of an experiment do not contain its number of runs.
    only = " Only a signature of it can show that it had no other runs." if about.kind == "experiment" else ""
    return whole + only


def _list_gaps(name: str, kind: str, own: Sequence[Record]) -> Iterator[Fault]:
    """The events that are missing in a stream."""
    for number, event in enumerate(own, 1):
        if event.head.version != number:
            at = event.head.position
            gap = f"this is event {event.head.version} of {name}, number {number} is missing"
            yield f"Position {at}: {gap}.", at
            break
    kinds = {event.head.type for event in own}
    if kind not in {BEGINS.get(each) for each in kinds}:
        yield f"The {'start' if kind == 'experiment' else 'submission'} of {name} is missing.", None
    if kinds.isdisjoint(ENDS[kind]):  # type: ignore[index]
        yield f"The end of {name} is missing.", None


def _is_submission(event: Record, subject: str) -> bool:
    return event.head.type == RunSubmitted.TYPE and belongs_to(event.payload, subject)


def _find_missing_rows(about: AboutBundle, own: Sequence[Record]) -> Iterator[Fault]:
    """The end of a campaign states its number of runs."""
    for event in own:
        if event.head.type == CampaignCompleted.TYPE:
            end = msgspec.json.decode(event.payload, type=CampaignCompleted)
            runs = end.completed + end.failed + end.cancelled
            if runs != len(about.runs):
                yield f"{about.of} had {runs} runs, but {len(about.runs)} are here.", None


def _check_signatures(about: AboutBundle, events: Sequence[Record]) -> Iterator[VerifiedPart]:
    """Whether people's signatures for the subject and its runs are for these records."""
    signed: list[str] = []
    faults: list[Fault] = []
    names = (about.of, *about.runs)
    for event in events:
        if not is_signature(event.head.type, event.payload, names):
            continue
        found: RunSigned | RecordsSigned
        if event.head.type == RunSigned.TYPE:
            found = msgspec.json.decode(event.payload, type=RunSigned)
            streams, more = {str(found.run)}, 0
            of = f" of {found.run}" if about.kind != "run" else ""
        else:
            found, of = msgspec.json.decode(event.payload, type=RecordsSigned), ""
            streams, more = {found.subject, *about.runs}, found.runs - len(about.runs)
        own = [each.envelope for each in events if each.head.stream in streams]
        signed.append(f"{found.by} ({found.meaning}{of}, {iso_time(event.head.recorded_at)})")
        if (more, found.records, found.digest) != (0, len(own), make_digest_of_records(own)):
            at = event.head.position
            faults.append((f"Position {at}: {found.by} signed other records than these.", at))
    if signed:
        result = f"{about.of} is signed by {', '.join(signed)}."
        yield VerifiedPart.sum_up("signed by", len(signed), result, faults)


def _check_words(files: dict[str, bytes], events: Sequence[Record]) -> Iterator[VerifiedPart]:
    """Whether the texts are those that people wrote into the events. A text that is not in the bundle was
    erased, or left out: that is not a fault."""
    named: dict[str, int] = {}
    for event in events:
        for reference in list_references(event.payload):
            named.setdefault(reference, event.head.position)
    faults: list[Fault] = []
    found: set[str] = set()
    for number, line in enumerate(files.get(WORDS, b"").splitlines(), 1):
        try:
            entry = _words_decoder.decode(line)
            kept = Kept(entry.reference, bytes.fromhex(entry.salt), entry.text)
        except (msgspec.MsgspecError, ValueError) as error:
            faults.append((f"Line {number} of {WORDS} cannot be read ({error}).", None))
            continue
        if kept.reference not in named:
            faults.append((f"Line {number} of {WORDS} is a text that belongs to no event.", None))
        elif kept.is_erased or not kept.is_genuine:
            at = named[kept.reference]
            faults.append((f"Position {at}: line {number} of {WORDS} was changed after it was written.", at))
        else:
            found.add(kept.reference)
    if not named and not faults:
        return
    left_out = len(named) - len(found)
    result = f"{len(found)} of {len(named)} texts of people are there and unchanged"
    result += f"; {left_out} were erased or left out." if left_out else "."
    yield VerifiedPart.sum_up("words", len(named), result, faults)


def _check_blobs(files: dict[str, bytes], events: Sequence[Record]) -> VerifiedPart:
    named: dict[str, int] = {}
    for event in events:
        for each in find_needed_blobs(event.head.type, event.payload):
            named.setdefault(each, event.head.position)
    faults: list[Fault] = []
    for each, position in named.items():
        data = files.get(f"{BLOBS}{each}")
        if data is None:
            fault = f"Position {position} names the file {each}, which is not in the bundle."
            faults.append((fault, position))
        elif digest(data) != each:
            fault = f"The file {each} that position {position} names was changed after it was stored."
            faults.append((fault, position))
    known = {ABOUT, NOTE, STAMP, ROTATIONS, EVENTS, WORDS, *(f"{BLOBS}{each}" for each in named)}
    faults += [
        (f"The bundle holds {name!r}, which no event names.", None) for name in files if name not in known
    ]
    result = f"{len(named)} files that the events name are there and unchanged."
    return VerifiedPart.sum_up("files", len(named), result, faults)


def _make_bundle_error(path: Path, why: str) -> BadInput:
    return BadInput(f"{path} is not a bundle: {why}.", remedy="Make one with labos bundle ID -o FILE.")
