"""A witness: cosigns a lab's checkpoint if it continues the previous one (C2SP ``tlog-witness``).

So a lab cannot show one log to one auditor and a different log to another. Before the witness answers, it
stores the lab's checkpoint in a folder.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import httpx
import msgspec

from labos.core.merkle import EMPTY_ROOT, is_consistent
from labos.errors import BadInput, LabosError, SystemFailed
from labos.services.trust.checkpoints import TreeHead, parse_tree_head
from labos.services.trust.notes import (
    SIGNS,
    Note,
    NoteSignature,
    PublicKey,
    SigningKey,
    parse_note,
    parse_signatures,
)
from labos.services.trust.places import TIMEOUT_S, Folder

LONGEST_PROOF = 63
SIZE_TYPE = "text/x.tlog.size"

Proof = Callable[[int], Sequence[bytes]]
"""The consistency proof from a size to the checkpoint's."""


class WitnessReply(msgspec.Struct, frozen=True):
    """A witness' answer: an HTTP status, a text and its type."""

    status: int
    text: str
    type: str = "text/plain; charset=utf-8"


class Witness:
    """``keys`` are the keys of the labs for which it cosigns; a lab is identified by its origin, the name of
    its key."""

    def __init__(self, folder: Path, key: SigningKey, keys: Sequence[PublicKey]) -> None:
        self._folder, self._key, self._keys = folder, key, keys
        self._one = threading.Lock()

    def add(self, body: bytes, now_s: int) -> WitnessReply:
        """Answer ``add-checkpoint``."""
        try:
            old, proof, note = parse_request(body)
            head = parse_tree_head(note.text)
        except BadInput as error:
            return WitnessReply(400, f"{error.message}\n")
        known = [key for key in self._keys if key.name == head.origin and key.kind == SIGNS]
        if not known:
            return WitnessReply(404, f"The lab {head.origin} is not known here.\n")
        try:
            signed = note.find_signers(known)
        except BadInput:
            signed = []
        if not signed:
            return WitnessReply(403, "This is not signed by a known key.\n")
        if old > head.size:
            return WitnessReply(400, "The old size is larger than the new one.\n")
        with self._one:  # no other request changes the size between reading and writing it
            return self._judge(old, proof, note, head, now_s)

    def _judge(
        self, old: int, proof: Sequence[bytes], note: Note, head: TreeHead, now_s: int
    ) -> WitnessReply:
        try:
            seen = self._read_last_checkpoint(head.origin)
        except LabosError as error:
            return WitnessReply(500, f"{error}\n")
        if old != seen.size or (old == head.size and seen.root != head.root):
            return WitnessReply(409, f"{seen.size}\n", SIZE_TYPE)
        if not is_consistent(old, seen.root, head.size, head.root, proof):
            return WitnessReply(422, "The proof does not show that this tree continues the previous one.\n")
        try:
            Folder(self._folder).put(_name_file(head.origin), note.encode())
        except SystemFailed as error:
            return WitnessReply(500, f"{error}\n")
        return WitnessReply(200, self._key.sign(note.text, now_s).line)

    def _read_last_checkpoint(self, origin: str) -> TreeHead:
        path = self._folder / _name_file(origin)
        if not path.exists():
            return TreeHead(origin, 0, EMPTY_ROOT)
        try:
            return parse_tree_head(parse_note(path.read_bytes()).text)
        except OSError as error:
            raise SystemFailed(f"{path} cannot be read: {error}.") from None


def _name_file(origin: str) -> str:
    return hashlib.sha256(origin.encode()).hexdigest() + ".note"


def parse_request(body: bytes) -> tuple[int, list[bytes], Note]:
    """Old size, proof and checkpoint of a request. Raises BadInput."""
    head, blank, rest = body.partition(b"\n\n")
    try:
        first, *lines = head.decode().split("\n")
        word, _, number = first.partition(" ")
        if not blank or word != "old" or number != str(int(number)) or len(lines) > LONGEST_PROOF:
            raise ValueError(first)
        proof = [base64.b64decode(line, validate=True) for line in lines]
        if any(len(each) != 32 for each in proof):
            raise ValueError("a hash has 32 bytes")
    except (ValueError, binascii.Error):
        raise BadInput("The request does not have the form of add-checkpoint.") from None
    return int(number), proof, parse_note(rest)


def encode_request(old: int, proof: Sequence[bytes], note: Note) -> bytes:
    lines = [f"old {old}", *(base64.b64encode(each).decode() for each in proof)]
    return "\n".join(lines).encode() + b"\n\n" + note.encode()


def ask_witness(url: str, note: Note, old: int, proof: Proof) -> tuple[NoteSignature, ...]:
    """Ask a witness to cosign. ``old`` is the expected size of its last checkpoint; if the size is another
    one, the witness reports it. Raises SystemFailed if it cannot be reached or does not agree."""
    target = url.rstrip("/") + "/add-checkpoint"
    size = parse_tree_head(note.text).size
    for _ in range(2):
        try:
            answer = httpx.post(target, content=encode_request(old, proof(old), note), timeout=TIMEOUT_S)
        except httpx.HTTPError as error:
            raise SystemFailed(f"The witness {url} cannot be reached: {error}.", remedy="Is it up?") from None
        seen = answer.text.strip()
        if answer.status_code != 409 or not seen.isdecimal() or int(seen) == old:
            break
        if int(seen) > size:
            raise SystemFailed(
                f"The witness {url} has seen a log of {seen} events, this one has {size}: it was cut off.",
                remedy="Check with labos verify.",
            )
        old = int(seen)
    if answer.status_code != 200:
        raise SystemFailed(
            f"The witness {url} does not cosign the checkpoint of size {size}: "
            f"{answer.status_code} {seen[:200]}",
            remedy="409 and 422: this log differs from the one that the witness saw before; 403 and 404: it "
            "does not have this lab's public key.",
        )
    try:
        return parse_signatures(answer.text)
    except ValueError as error:
        raise SystemFailed(f"The witness {url} gives an answer that is not a signature ({error}).") from None
