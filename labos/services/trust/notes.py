"""Signed notes (C2SP ``signed-note``): a text, and lines with its signatures.

A key has a name, and an id that is computed from name, kind and key. Kinds: 1 is Ed25519 over the text, 4 is
a witness' cosignature of a checkpoint (``tlog-cosignature``), which contains its time.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Iterable

import msgspec
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from labos.errors import BadInput

SIGNS, COSIGNS = 1, 4
"""Kinds of keys."""

MOST_BYTES = 64 * 1024
MOST_SIGNATURES = 64
"""A note may have at most so many signatures."""

_PRIVATE = "PRIVATE+KEY+"
_DASH = "— "
SIGNED = f"\n\n{_DASH}".encode()
"""The end of the text and the beginning of the signatures of a note."""
_KINDS = {SIGNS: "signs", COSIGNS: "cosigns"}


class PublicKey(msgspec.Struct, frozen=True):
    """The key that checks signatures. ``raw`` is the Ed25519 key, 32 bytes."""

    name: str
    kind: int
    raw: bytes

    @property
    def id(self) -> bytes:
        data = self.name.encode() + b"\n" + bytes([self.kind]) + self.raw
        return hashlib.sha256(data).digest()[:4]

    @property
    def text(self) -> str:
        """The form in which people pass it on: ``name+id+key``."""
        return f"{self.name}+{self.id.hex()}+{_encode_base64(bytes([self.kind]) + self.raw)}"

    def verifies(self, text: bytes, signature: bytes) -> bool:
        if self.kind == COSIGNS:
            if len(signature) != 72:
                return False
            text, signature = _encode_cosigned(text, int.from_bytes(signature[:8])), signature[8:]
        try:
            Ed25519PublicKey.from_public_bytes(self.raw).verify(signature, text)
        except (InvalidSignature, ValueError):
            return False
        return True


class SigningKey(msgspec.Struct, frozen=True):
    """The key that makes signatures. ``seed`` is the Ed25519 private key, 32 bytes."""

    name: str
    kind: int
    seed: bytes

    def __repr__(self) -> str:
        return f"SigningKey({self.public.text})"

    @property
    def public(self) -> PublicKey:
        return PublicKey(self.name, self.kind, self._key().public_key().public_bytes_raw())

    @property
    def text(self) -> str:
        """The form in which a file stores it."""
        return (
            f"{_PRIVATE}{self.name}+{self.public.id.hex()}+{_encode_base64(bytes([self.kind]) + self.seed)}"
        )

    def sign(self, text: str, time_s: int = 0) -> NoteSignature:
        """Sign a text; a cosignature contains ``time_s`` (UTC, since 1970)."""
        data = text.encode()
        if self.kind == COSIGNS:
            signature = time_s.to_bytes(8) + self._key().sign(_encode_cosigned(data, time_s))
        else:
            signature = self._key().sign(data)
        return NoteSignature(self.name, self.public.id, signature)

    def _key(self) -> Ed25519PrivateKey:
        return Ed25519PrivateKey.from_private_bytes(self.seed)


class NoteSignature(msgspec.Struct, frozen=True):
    """A line with a signature. The first 8 bytes of a cosignature are its time."""

    name: str
    key_id: bytes
    raw: bytes

    @property
    def line(self) -> str:
        return f"{_DASH}{self.name} {_encode_base64(self.key_id + self.raw)}\n"

    def is_by(self, key: PublicKey) -> bool:
        return (self.name, self.key_id) == (key.name, key.id)

    @property
    def time_s(self) -> int:
        """The time of a cosignature, by its witness' clock."""
        return int.from_bytes(self.raw[:8])


class Note(msgspec.Struct, frozen=True):
    """A text that ends with a newline, and its signatures."""

    text: str
    signatures: tuple[NoteSignature, ...] = ()

    def encode(self) -> bytes:
        return (self.text + "\n" + "".join(each.line for each in self.signatures)).encode()

    def with_signatures(self, more: Iterable[NoteSignature]) -> Note:
        """The same note with further signatures; for each key the newer one is kept."""
        by_key = {(each.name, each.key_id): each for each in (*self.signatures, *more)}
        return Note(self.text, tuple(by_key.values()))

    def find_signers(self, keys: Iterable[PublicKey]) -> list[PublicKey]:
        """The keys that have signed this note. Signatures of other keys are ignored. Raises BadInput if a
        signature has the id of one of the keys and is not valid."""
        found = []
        for key in keys:
            for signature in self.signatures:
                if signature.is_by(key):
                    if not key.verifies(self.text.encode(), signature.raw):
                        raise BadInput(
                            f"The signature of {key.name} does not match: the text or the signature "
                            "was changed.",
                            remedy="Get the original file again.",
                        )
                    found.append(key)
                    break
        return found


def make_key(name: str, kind: int, seed: bytes) -> SigningKey:
    """Raises BadInput for a name that a note cannot contain."""
    _check_name(name)
    return SigningKey(name, kind, seed)


def parse_public_key(text: str) -> PublicKey:
    """The key in the form ``name+id+key``. Raises BadInput."""
    name, key_id, kind, raw = _split_key(text.strip(), "public")
    key = PublicKey(name, kind, raw)
    if key.id != key_id:
        raise _make_key_error("public", "its id does not match its name and key")
    return key


def parse_signing_key(text: str) -> SigningKey:
    """The key in a file of ``labos key``. Raises BadInput."""
    if not text.startswith(_PRIVATE):
        raise _make_key_error("private", f"it does not begin with {_PRIVATE}")
    name, key_id, kind, seed = _split_key(text.removeprefix(_PRIVATE).strip(), "private")
    key = SigningKey(name, kind, seed)
    if key.public.id != key_id:
        raise _make_key_error("private", "its id does not match its name and key")
    return key


def parse_note(data: bytes) -> Note:
    """Raises BadInput if the data is not a signed note."""
    try:
        if len(data) > MOST_BYTES:
            raise ValueError(f"it is larger than {MOST_BYTES} bytes")
        whole = data.decode()
        if any(ord(each) < 32 and each != "\n" for each in whole):
            raise ValueError("it holds control characters")
        text, blank, lines = whole.rpartition("\n\n")
        if not blank or not text or not lines.endswith("\n"):
            raise ValueError("it has no signatures")
        return Note(text + "\n", parse_signatures(lines))
    except ValueError as error:
        raise BadInput(
            f"This is not a signed note: {error}.", remedy="Give a file of labos checkpoint."
        ) from None


def parse_signatures(lines: str) -> tuple[NoteSignature, ...]:
    """The lines with signatures. Raises ValueError."""
    found = []
    for line in lines.splitlines():
        name, space, value = line.removeprefix(_DASH).partition(" ")
        raw = base64.b64decode(value, validate=True)
        if not line.startswith(_DASH) or not space or len(raw) < 5:
            raise ValueError("a line of its signatures cannot be read")
        found.append(NoteSignature(name, raw[:4], raw[4:]))
    if not 1 <= len(found) <= MOST_SIGNATURES:
        raise ValueError(f"it has {len(found)} signatures")
    return tuple(found)


def _encode_cosigned(text: bytes, time_s: int) -> bytes:
    return b"cosignature/v1\ntime %d\n" % time_s + text


def _split_key(text: str, what: str) -> tuple[str, bytes, int, bytes]:
    pieces = text.split("+", 2)
    if len(pieces) != 3:
        raise _make_key_error(what, "it does not have the form name+id+key")
    name, key_id, value = pieces
    _check_name(name)
    try:
        raw = base64.b64decode(value, validate=True)
        found = bytes.fromhex(key_id)
    except (binascii.Error, ValueError) as error:
        raise _make_key_error(what, str(error)) from None
    if len(raw) != 33 or raw[0] not in _KINDS or len(found) != 4:
        raise _make_key_error(what, "it is of an unknown kind")
    return name, found, raw[0], raw[1:]


def _check_name(name: str) -> None:
    if not name or "+" in name or not name.isprintable() or any(each.isspace() for each in name):
        raise BadInput(
            f"{name!r} cannot be the name of a key.",
            remedy="Give one without spaces and without +, such as chem.example.org/lab1.",
        )


def _make_key_error(what: str, why: str) -> BadInput:
    return BadInput(f"This is not a {what} key: {why}.", remedy="Give one that labos key has made.")


def _encode_base64(data: bytes) -> str:
    return base64.b64encode(data).decode()
