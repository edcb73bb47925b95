"""Makes a checkpoint of a log and sends it to the places where it is kept."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec

from labos.core.merkle import Tree, hash_leaf, list_consistency_ranges, make_growth_proof, make_proof
from labos.errors import BadInput, LabosError, LogDamaged, Refused
from labos.services.log import Log
from labos.services.trust.checkpoints import (
    TreeHead,
    compute_roots_at,
    parse_tree_head,
    sign_tree,
)
from labos.services.trust.keys import SigningKeys
from labos.services.trust.notes import Note, NoteSignature, PublicKey, parse_note
from labos.services.trust.places import Folder, find_newest, name_checkpoint, place_of
from labos.services.trust.timestamp import request_stamp
from labos.services.trust.tree import Growth, grow, read_tree, store_tree
from labos.services.trust.witness import ask_witness

FOLDER = "checkpoints"
"""A folder in the lab's own folder, with a copy of each checkpoint. It is not a proof for others."""


class Targets(msgspec.Struct, frozen=True):
    """The destinations of checkpoints: ``places`` are folders and URLs; ``witnesses`` are URLs of witnesses
    who should cosign; ``witness_keys`` check the cosignatures (none: every cosignature is kept); ``stamp`` is
    the URL of a time stamp authority."""

    places: tuple[str, ...] = ()
    witnesses: tuple[str, ...] = ()
    witness_keys: tuple[PublicKey, ...] = ()
    stamp: str = ""


class PublishResult(msgspec.Struct, frozen=True):
    """A checkpoint, the places to which it was written, and the failures."""

    head: TreeHead
    note: Note
    written: tuple[str, ...]
    faults: tuple[str, ...]
    stamped: bool = False


def publish(log: Log, home: Path, targets: Targets) -> PublishResult:
    """Sign the log's end and send it to all targets; a failure at one target does not stop the others. Raises
    LogDamaged if the log contradicts an earlier checkpoint, NotFound without a key, BadInput, Refused for an
    empty log, StoreUnavailable."""
    key = SigningKeys(home).read_signing_key()
    places = (Folder(home / FOLDER), *(place_of(each) for each in targets.places))
    kept = read_tree(home)
    growth = grow(log, kept)
    if not growth.after.size:
        raise Refused("The log is empty: there is nothing to sign.", remedy="Start the lab first.")
    if not kept.size:
        _check_newest(log, home)
    head = TreeHead(key.name, growth.after.size, growth.after.compute_root())
    store_tree(home, growth.kept)  # before anybody sees the signature: no other tree will be signed
    note = _read_signed(home, head).with_signatures(sign_tree(head, key).signatures)
    faults: list[str] = []
    for url in targets.witnesses:
        try:
            note = note.with_signatures(_ask_cosignatures(url, log, note, growth, targets.witness_keys))
        except LabosError as error:
            faults.append(str(error))
    name = name_checkpoint(head.size)
    files = {name: note.encode()}
    if targets.stamp:
        try:
            files[f"{name[:-5]}.tsr"] = request_stamp(targets.stamp, note.text.encode())
        except LabosError as error:
            faults.append(str(error))
    written = []
    for place in places:
        try:
            for file, data in files.items():
                place.put(file, data)
            written.append(str(place))
        except LabosError as error:
            faults.append(str(error))
    return PublishResult(head, note, tuple(written), tuple(faults), len(files) > 1)


def _read_signed(home: Path, head: TreeHead) -> Note:
    """The earlier signed checkpoint of this tree, with its cosignatures: none is lost if the checkpoint is
    made again."""
    try:
        found = parse_note((home / FOLDER / name_checkpoint(head.size)).read_bytes())
    except (OSError, BadInput):
        return Note(head.text)
    return found if found.text == head.text else Note(head.text)


def _check_newest(log: Log, home: Path) -> None:
    """If no tree is stored, the lab's own copies still show the last signed checkpoint."""
    newest = find_newest(home / FOLDER)
    if newest is None:
        return
    seen = parse_tree_head(parse_note(newest.read_bytes()).text)
    if compute_roots_at(log, [seen.size]).get(seen.size) != seen.root:
        raise LogDamaged(
            f"The log contradicts the checkpoint {newest}: it was rewritten, or its tail was cut off.",
            position=min(seen.size, log.head().position + 1),
            remedy="Nothing was signed. Check with labos verify --checkpoint FILE.",
        )


def _ask_cosignatures(
    url: str, log: Log, note: Note, growth: Growth, keys: Sequence[PublicKey]
) -> list[NoteSignature]:
    def proof(old: int) -> list[bytes]:
        if old == growth.before.size:
            return make_growth_proof(growth.before, growth.added) if old else []
        if not 0 < old < growth.after.size:
            return []
        # The witness missed some checkpoints, or has seen this one: all leaves are needed.
        whole = Tree(hash_leaf(record.envelope) for record in log.read(0, growth.after.size))
        return make_proof(list_consistency_ranges(old, growth.after.size), whole.hash_of)

    found = ask_witness(url, note, growth.before.size, proof)
    if not keys:
        return list(found)
    known = [signature for signature in found if any(signature.is_by(key) for key in keys)]
    if not known or not Note(note.text, tuple(known)).find_signers(keys):
        raise BadInput(
            f"The witness {url} has not signed with one of the given keys.", remedy="Ask for its key."
        )
    return known
