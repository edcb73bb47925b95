"""The checks of ``labos verify`` beside the chain: snapshot, end of the log, blobs, words, journals,
benches.

Each check reports what was checked, how many things, and each fault in one sentence that names the place.
"""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Protocol

import msgspec

from labos.core.erasure import list_erased, list_references_in_words
from labos.core.fold import fold_rows
from labos.core.labware import SamplesRegistered
from labos.core.modules import ModuleCalibrated
from labos.core.plans import PlanRecorded
from labos.core.runs import RunSubmitted
from labos.core.state import LabState, encode_picture, fold_fingerprint
from labos.errors import JournalDamaged, LabosError, LogDamaged, NotFound
from labos.node.journal import Memory, read_journal
from labos.ports import BlobReader, Log, StoredSnapshot, StoredWords

_DIGEST = re.compile(rb"[0-9a-f]{64}")
_RESULT = frozenset({"file", "sha256", "bytes"})
"""The fields of a file in a result."""

Fault = tuple[str, int | None]
"""A fault in one sentence, and its position in the log; None if it has no position."""


class VerifiedPart(msgspec.Struct, frozen=True):
    """One part that was checked. ``checked`` is the number of checked things; ``result`` is the result in a
    sentence; ``faults`` are the faults, and ``positions`` their positions in the log."""

    name: str
    checked: int
    result: str
    faults: tuple[str, ...] = ()
    positions: tuple[int, ...] = ()

    @classmethod
    def sum_up(cls, name: str, checked: int, result: str, found: Sequence[Fault]) -> VerifiedPart:
        """A part with the faults that were found."""
        positions = tuple(position for _, position in found if position is not None)
        return cls(name, checked, result, tuple(fault for fault, _ in found), positions)

    @classmethod
    def fail(cls, name: str, checked: int, fault: str, *positions: int) -> VerifiedPart:
        """A part whose result is a fault."""
        return cls(name, checked, fault, (fault,), positions)


class VerifiableStore(Log, Protocol):
    """An event store with words beside the log, for reading."""

    def flaw(self) -> str: ...
    def all_words(self) -> Iterator[StoredWords]: ...
    def erasures(self) -> Mapping[str, int]: ...

    @property
    def known_position(self) -> int: ...
    def read_snapshot_row(self) -> StoredSnapshot | None: ...


class Blobs(BlobReader, Protocol):
    def names(self) -> Iterator[str]: ...


def check_database(store: VerifiableStore) -> VerifiedPart:
    """Whether the database reports its own tables and indices as intact. The chain does not cover the
    indices, which queries use. Raises StoreUnavailable."""
    if flaw := store.flaw():
        return VerifiedPart.fail(
            "database", 1, f"The database finds its own tables or indices damaged: {flaw}."
        )
    return VerifiedPart("database", 1, "The database finds no fault with its tables and indices.")


def check_snapshot(store: VerifiableStore) -> VerifiedPart:
    """Whether the snapshot is genuine and equals the folded log. The log must be intact."""
    found = store.read_snapshot_row()
    if found is None:
        return VerifiedPart("snapshot", 0, "There is no snapshot.")
    if not found.genuine:
        refusal = f"The snapshot of position {found.position} is not used: {found.fault}."
        broken = (refusal,) if found.tampered else ()
        return VerifiedPart("snapshot", 1, refusal, broken, (found.position,) if broken else ())
    if found.on_log != found.hash:
        there = "after the end of the log" if found.on_log is None else "but the log has another record there"
        fault = f"The sealed snapshot is of position {found.position}, {there}: the log was cut or rewritten."
        return VerifiedPart.fail("snapshot", 1, fault, found.position)
    if found.fingerprint != fold_fingerprint():
        result = f"The snapshot of position {found.position} is sealed; another version of LabOS made it."
        return VerifiedPart("snapshot", 1, result)
    state = LabState()
    fold_rows(state, store.replay(0, found.position))
    if encode_picture(state) != found.data:
        fault = f"The sealed snapshot of position {found.position} differs from the state by the log."
        return VerifiedPart.fail("snapshot", 1, fault, found.position)
    return VerifiedPart(
        "snapshot", 1, f"The snapshot of position {found.position} is sealed and agrees with the log."
    )


def check_end(store: VerifiableStore) -> VerifiedPart:
    """Whether there is a trace that the log was longer."""
    known, position = store.known_position, store.head().position
    if not known:
        return VerifiedPart("end", 0, "There is no record of how long the log once was.")
    if not position:
        fault = (
            f"The log is empty, but the log of this lab's folder once ended at {known}: it is lost, "
            "or this is the wrong database."
        )
        return VerifiedPart.fail("end", 1, fault, 1)
    if known > position:
        fault = f"The log ends at position {position}, but it once ended at {known}: its end is lost."
        return VerifiedPart.fail("end", 1, fault, position + 1)
    return VerifiedPart("end", 1, f"By the note in the lab's folder, the log has at least {known} positions.")


def check_blobs(log: Log, blobs: Blobs) -> VerifiedPart:
    """Whether each blob that the log names exists and has the right digest; blobs that no event names are
    counted. Raises StoreUnavailable."""
    stored = set(blobs.names())  # read before the log: a blob exists before the event that names it
    named, mentioned = _list_digests(log)
    found: list[Fault] = []
    for digest, position in named.items():
        try:
            blobs.get(digest)
        except NotFound:
            found.append((f"Position {position} names the blob {digest}, which is missing.", position))
        except LogDamaged:
            fault = f"The blob {digest} that position {position} names was changed after it was stored."
            found.append((fault, position))
    good = len(named) - len(found)
    others = stored - named.keys()
    for digest in sorted(others):
        try:
            blobs.get(digest)
        except NotFound:  # another process has removed it meanwhile
            continue
        except LogDamaged:
            fault = f"The blob {digest}, which the log does not need, was changed after it was stored."
            found.append((fault, None))
    unnamed = len(others - mentioned)
    result = f"Blobs: the log names {len(named)}, {good} are there and unchanged"
    result += f"; {unnamed} others are there." if unnamed else "."
    return VerifiedPart.sum_up("blobs", len(named) + len(others), result, found)


def find_unused_blobs(log: Log, blobs: Blobs) -> list[str]:
    """The blobs that no event of the log names in any field. Raises StoreUnavailable."""
    stored = set(blobs.names())  # read before the log: a blob exists before the event that names it
    named, mentioned = _list_digests(log)
    return sorted(stored - named.keys() - mentioned)


def check_words(store: VerifiableStore) -> VerifiedPart:
    """Whether each text beside the log is unchanged, and whether an event explains each missing text. The
    event is in this log, or in a newer copy of it that the lab's folder knows of. Raises StoreUnavailable,
    BadInput."""
    named, erased = _count_references(store)
    elsewhere = store.erasures()
    found: list[tuple[int, str]] = []
    whole = gone = apart = 0
    for standing in store.all_words():
        name, position = standing.words.reference, standing.position
        named.pop(name, None)
        if standing.words.is_erased:
            gone += name in erased
            apart += name not in erased and name in elsewhere
            if name not in erased and name not in elsewhere:
                found.append((position, "words are gone, but no event records their erasure"))
        elif name in erased:
            found.append((position, f"words are there although they were erased at position {erased[name]}"))
        elif not standing.words.is_genuine:
            found.append((position, "the words stored beside the log were changed after they were written"))
        else:
            whole += 1
    found += [
        (position, "words are missing beside the log, but no event records their erasure")
        for name, position in named.items()
        if name not in erased
    ]
    found.sort()
    result = f"Words beside the log: {whole} are unchanged, {gone} were erased"
    result += f", {apart} in a newer copy of this log." if apart else "."
    faults = [(f"Position {position}: {fault}.", position) for position, fault in found]
    return VerifiedPart.sum_up("words", whole + gone + apart + len(found), result, faults)


def check_journals(folder: Path) -> tuple[VerifiedPart, dict[str, Memory]]:
    """Whether the nodes' journals can be read, with their checksums; also returns the journals that can."""
    found: dict[str, Memory] = {}
    faults = []
    files = sorted(folder.glob("*.journal"))
    for path in files:
        try:
            found[path.stem] = read_journal(path.read_bytes())
        except (JournalDamaged, OSError) as error:
            why = error.message if isinstance(error, LabosError) else str(error)
            faults.append(f"The journal {path} is damaged: {why}")
    result = f"Journals: {len(found)} of {len(files)} can be read."
    return VerifiedPart("journals", len(files), result, tuple(faults)), found


def check_benches(folder: Path) -> VerifiedPart:
    """Whether the records of simulated benches can be read. They have no checksums: a changed character in
    one is not found here."""
    files = sorted(folder.glob("*.db"))
    motions, faults = 0, []
    for path in files:
        try:
            motions += _count_motions(path)
        except (sqlite3.Error, ValueError, TypeError) as error:
            faults.append(f"The record {path} of a simulated bench is damaged: {error}.")
    return VerifiedPart(
        "benches", len(files), f"Simulated benches: {len(files)}, {motions} motions.", tuple(faults)
    )


def _count_motions(path: Path) -> int:
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=5)) as record:
        (sound,) = record.execute("PRAGMA integrity_check(1)").fetchone()
        if sound != "ok":
            raise ValueError(sound)
        number = 0
        for number, (seq, facts) in enumerate(
            record.execute("SELECT seq, facts FROM motion ORDER BY seq"), 1
        ):
            if seq != number:
                raise ValueError(f"motion {number} is missing")
            if not isinstance(msgspec.json.decode(facts), dict):
                raise ValueError(f"motion {number} cannot be read")
        return number


def _list_digests(log: Log) -> tuple[dict[str, int], set[str]]:
    """The blobs that the log needs, by the position that first names each, and all other texts in it that
    look like the name of a blob."""
    named: dict[str, int] = {}
    mentioned: set[str] = set()
    for position, kind, _, _, payload in log.replay():
        found = _DIGEST.findall(payload)
        if not found:
            continue
        mentioned.update(digest.decode() for digest in found)
        for digest in find_needed_blobs(kind, payload):
            named.setdefault(digest, position)
    return named, mentioned


def _count_references(log: Log) -> tuple[dict[str, int], dict[str, int]]:
    """The references in fields of words, and the references that events list as erased; each with its
    position."""
    named: dict[str, int] = {}
    erased: dict[str, int] = {}
    for position, kind, schema, _, payload in log.replay():
        erased.update((reference, position) for reference in list_erased(kind, schema, payload))
        for reference in list_references_in_words(kind, payload):
            named.setdefault(reference, position)
    return named, erased


def find_needed_blobs(kind: str, payload: bytes) -> list[str]:
    """The blobs that an event of a type needs, according to its stored payload: workflows and files of runs,
    sample sheets, files of results, reports of calibrations."""
    try:
        content: Any = msgspec.json.decode(payload)
    except msgspec.DecodeError:
        return []
    found: list[Any] = []
    match kind:
        case RunSubmitted.TYPE:
            found.append(content.get("pins", {}).get("workflow"))
        case PlanRecorded.TYPE:
            found.extend(content.get("files", {}).values())
        case SamplesRegistered.TYPE:
            found.extend((content.get("sheet"), content.get("blob")))
        case ModuleCalibrated.TYPE:
            found.append(content.get("file"))
    waiting = [content]
    while waiting:
        item = waiting.pop()
        if isinstance(item, dict):
            if item.keys() == _RESULT:
                found.append(item["sha256"])
            waiting.extend(item.values())
        elif isinstance(item, list):
            waiting.extend(item)
    return [each for each in found if isinstance(each, str) and _DIGEST.fullmatch(each.encode())]
