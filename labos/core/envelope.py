"""The envelope of every event, and the chain that connects each event with the next.

``hash = SHA-256(previous hash ‖ envelope bytes)``. The envelope names the payload by its digest, so the chain
covers payloads too. The stored bytes are the bytes that were hashed; they are never serialised again for
verification.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator

import msgspec

from labos.core.canonical import digest
from labos.core.words import Kept
from labos.errors import LogDamaged

GENESIS = bytes(32)
"""The hash before position 1."""

MAX_PAYLOAD_BYTES = 64 * 1024
"""Larger data is stored as a blob."""


class Envelope(msgspec.Struct, frozen=True):
    """The data of a record around its payload: position, actor, time, causes. ``recorded_at`` is in UTC
    nanoseconds and never decreases."""

    lab: str
    position: int
    id: str
    stream: str
    version: int
    type: str
    schema: int
    recorded_at: int
    actor: str
    correlation: str
    causation: str
    digest: str


class Record(msgspec.Struct, frozen=True):
    """One record of the log as it is stored: the envelope, its exact bytes, payload and hash. ``words`` are
    the texts to be written beside it. A record that was read does not have them (see ``words_of`` of a
    store)."""

    head: Envelope
    envelope: bytes
    payload: bytes
    hash: bytes
    words: tuple[Kept, ...] = ()


_encode_envelope = msgspec.json.Encoder(order="sorted").encode  # texts and whole numbers only
_decode_envelope = msgspec.json.Decoder(Envelope).decode


def seal(previous_hash: bytes, head: Envelope, payload: bytes) -> Record:
    """Complete an envelope with its payload and chain it to the record before. Raises ValueError for a NUL
    character in one of its texts, which PostgreSQL cannot store."""
    envelope = _encode_envelope(head)
    if b"\\u0000" in envelope and any("\0" in str(text) for text in msgspec.structs.astuple(head)):
        raise ValueError("A name, an actor or a stream holds a NUL character and cannot be recorded.")
    return Record(head, envelope, payload, hashlib.sha256(previous_hash + envelope).digest())


class Folded(msgspec.Struct, frozen=True, gc=False):
    """The fields of an envelope that a fold needs."""

    lab: str
    position: int
    type: str
    schema: int
    recorded_at: int
    digest: str


decode_folded = msgspec.json.Decoder(Folded).decode
"""Decodes only the folded part of an envelope, which is much faster than the whole."""


def check_chain(
    records: Iterable[Record],
    before: bytes = GENESIS,
    after: int = 0,
    remedy: str = "The records before it can be trusted.",
) -> Iterator[Record]:
    """The same records, as long as each follows the one before in the chain; the first one follows the
    position ``after``, where the hash is ``before``. Raises LogDamaged."""
    for position, record in enumerate(records, after + 1):
        missing = record.head.position != position
        if fault := "the record is missing" if missing else find_damage(before, record):
            raise LogDamaged(f"Position {position}: {fault}.", position=position, remedy=remedy)
        before = record.hash
        yield record


def find_damage(previous_hash: bytes, record: Record) -> str:
    """The damage of a stored record, in one sentence; empty if there is none."""
    if hashlib.sha256(previous_hash + record.envelope).digest() != record.hash:
        return "the hash does not follow from the record before"
    try:
        head = _decode_envelope(record.envelope)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        return f"the envelope cannot be read ({error})"
    if head != record.head:
        fields = [
            name for name in Envelope.__struct_fields__ if getattr(head, name) != getattr(record.head, name)
        ]
        return f"the stored columns contradict the envelope ({', '.join(fields)})"
    if digest(record.payload) != head.digest:
        return "the payload is not the one that was recorded"
    return ""
