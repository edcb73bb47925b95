"""The chain: what is sealed, and how each kind of damage shows."""

from __future__ import annotations

import hashlib

import msgspec
import pytest

from labos.core.canonical import digest, encode_canonical
from labos.core.envelope import GENESIS, Envelope, Record, find_damage, seal

PAYLOAD = b'{"why":"test"}'


def head(position: int = 1, **more: object) -> Envelope:
    fields = {
        "lab": "lab-1",
        "position": position,
        "id": "0190",
        "stream": "R1",
        "version": 1,
        "type": "run.cancelled",
        "schema": 1,
        "recorded_at": 5,
        "actor": "ada",
        "correlation": "R1",
        "causation": "",
        "digest": digest(PAYLOAD),
    }
    return Envelope(**{**fields, **more})  # type: ignore[arg-type]


def test_the_hash_covers_the_one_before_and_every_field_of_the_envelope() -> None:
    record = seal(GENESIS, head(), PAYLOAD)
    assert record.hash == hashlib.sha256(bytes(32) + encode_canonical(head())).digest()
    assert find_damage(GENESIS, record) == ""
    second = seal(record.hash, head(2), PAYLOAD)
    assert find_damage(record.hash, second) == ""
    hashes = {seal(GENESIS, head(), PAYLOAD).hash}
    for name in Envelope.__struct_fields__:
        changed = 99 if isinstance(getattr(head(), name), int) else "other"
        hashes.add(seal(GENESIS, head(**{name: changed}), PAYLOAD).hash)
    assert len(hashes) == 1 + len(Envelope.__struct_fields__)


def test_a_record_behind_another_one_does_not_fit() -> None:
    record = seal(GENESIS, head(), PAYLOAD)
    assert find_damage(bytes([1] * 32), record) == "the hash does not follow from the record before"


def test_changed_bytes_of_the_envelope_show() -> None:
    record = seal(GENESIS, head(), PAYLOAD)
    forged = msgspec.structs.replace(record, envelope=record.envelope.replace(b'"ada"', b'"bob"'))
    assert find_damage(GENESIS, forged) == "the hash does not follow from the record before"


def test_an_envelope_that_is_none_shows_even_with_a_fitting_hash() -> None:
    junk = b"{}"
    record = Record(head(), junk, PAYLOAD, hashlib.sha256(GENESIS + junk).digest())
    assert find_damage(GENESIS, record).startswith("the envelope cannot be read (")


@pytest.mark.parametrize(("field", "value"), [("actor", "bob"), ("position", 7), ("recorded_at", 0)])
def test_columns_that_contradict_the_envelope_are_named(field: str, value: object) -> None:
    record = seal(GENESIS, head(), PAYLOAD)
    forged = msgspec.structs.replace(record, head=head(**{field: value}))
    assert find_damage(GENESIS, forged) == f"the stored columns contradict the envelope ({field})"


def test_another_payload_shows() -> None:
    record = seal(GENESIS, head(), PAYLOAD)
    forged = msgspec.structs.replace(record, payload=b'{"why":"lie"}')
    assert find_damage(GENESIS, forged) == "the payload is not the one that was recorded"


@pytest.mark.parametrize("field", ["actor", "stream", "correlation", "causation", "id"])
def test_a_nul_character_is_refused_where_a_database_cannot_keep_it(field: str) -> None:
    with pytest.raises(ValueError, match="NUL"):
        seal(GENESIS, head(**{field: "a\0b"}), PAYLOAD)
    seal(GENESIS, head(**{field: "a\\u0000b"}), PAYLOAD)
