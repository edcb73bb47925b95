"""The keys of a lab, in the folder ``keys/`` of the lab.

================  ===========================================================================
``signing.key``   the private key that signs checkpoints; only its owner may read it
``witness.key``   the private key that cosigns other labs' checkpoints
``public.keys``   the public keys of the first file, a line each, the oldest first
``rotation.notes``  for each change of key a note that the old and the new key have signed
================  ===========================================================================
"""

from __future__ import annotations

import secrets
from collections.abc import Iterable, Sequence
from pathlib import Path

from labos.errors import BadInput, NotFound, Refused
from labos.private import make_folder, replace_file, tighten
from labos.services.trust.checkpoints import TreeHead
from labos.services.trust.notes import (
    COSIGNS,
    SIGNS,
    Note,
    PublicKey,
    SigningKey,
    make_key,
    parse_note,
    parse_public_key,
    parse_signing_key,
)

SIGNING_FILE, WITNESS_FILE = "signing.key", "witness.key"
PUBLIC_FILE, ROTATION_FILE = "public.keys", "rotation.notes"
ROTATION = "labos key rotation"
"""The first line of a note in which a key names its successor. No checkpoint can begin with it, as names have
no spaces."""

_BETWEEN = b"\n---\n"


class SigningKeys:
    """The keys in one lab's folder."""

    def __init__(self, home: Path) -> None:
        self.folder = home / "keys"

    def create(self, name: str, *, witness: bool = False) -> PublicKey:
        """Make a key pair. Raises Refused if there is one already, BadInput for a name that is not
        allowed."""
        path = self._find_file(witness)
        if path.exists():
            raise Refused(
                f"This lab already has a key: {path}.",
                remedy="Show it with labos key show. To replace it: labos key rotate.",
            )
        key = make_key(name, COSIGNS if witness else SIGNS, secrets.token_bytes(32))
        make_folder(self.folder)
        replace_file(path, key.text.encode() + b"\n")
        if not witness:
            replace_file(self.folder / PUBLIC_FILE, key.public.text.encode() + b"\n")
        return key.public

    def read_signing_key(self, *, witness: bool = False) -> SigningKey:
        """The private key. Raises NotFound if there is none, BadInput if it cannot be read."""
        path = self._find_file(witness)
        made = "labos key create --witness" if witness else "labos key create"
        try:
            tighten([self.folder, path], "the lab's private keys")
            return parse_signing_key(path.read_text())
        except FileNotFoundError:
            raise NotFound(f"This lab has no key {path}.", remedy=f"Make one: {made}") from None
        except (OSError, UnicodeDecodeError) as error:
            raise BadInput(
                f"The key {path} cannot be read: {error}.", remedy="Correct or restore the file."
            ) from None

    def list_public_keys(self) -> list[PublicKey]:
        """The public keys with which this lab has signed, oldest first. Raises BadInput."""
        return read_public_keys(self.folder / PUBLIC_FILE) if (self.folder / PUBLIC_FILE).exists() else []

    def read_rotations(self) -> tuple[Note, ...]:
        """The notes in which each key named its successor. Raises BadInput."""
        try:
            return parse_rotations((self.folder / ROTATION_FILE).read_bytes())
        except FileNotFoundError:
            return ()

    def rotate(self, size: int, time: str) -> Note:
        """Replace the present key by a new one. The old private key is destroyed, so it signs nothing larger
        than ``size``. Returns the note that both keys have signed. Raises NotFound, BadInput."""
        old = self.read_signing_key()
        fresh = make_key(old.name, SIGNS, secrets.token_bytes(32))
        text = f"{ROTATION}\n{size}\n{old.public.text}\n{fresh.public.text}\n{time}\n"
        note = Note(text, (old.sign(text), fresh.sign(text)))
        known = [each.text for each in self.list_public_keys()] + [fresh.public.text]
        # The private key is replaced last: until then the old one signs, which the notes allow up to this
        # size.
        replace_file(self.folder / ROTATION_FILE, encode_rotations((*self.read_rotations(), note)))
        replace_file(self.folder / PUBLIC_FILE, "".join(f"{each}\n" for each in known).encode())
        replace_file(self._find_file(False), fresh.text.encode() + b"\n")
        return note

    def _find_file(self, witness: bool) -> Path:
        return self.folder / (WITNESS_FILE if witness else SIGNING_FILE)


class TrustedKeys:
    """The keys that the reader trusts: those that were given, and their successors. ``ended`` has, for each
    key with a successor, the largest size of a tree that the key may have signed."""

    def __init__(self, given: Sequence[PublicKey], rotations: Iterable[Note] = ()) -> None:
        """Raises BadInput for a rotation that was changed."""
        self.keys = list(given)
        self._ended: dict[str, int] = {}
        for note in rotations:
            size, old, fresh = _parse_rotation(note)
            if old not in self.keys:
                continue  # a rotation proves nothing if the old key is not trusted
            if note.find_signers([old, fresh]) != [old, fresh]:
                raise BadInput(
                    f"A change of the key {old.name} is not signed by both keys.",
                    remedy="Get the public key from the lab in another way.",
                )
            self._ended[old.text] = size
            if fresh not in self.keys:
                self.keys.append(fresh)

    def list_for(self, origin: str) -> list[PublicKey]:
        """The trusted keys of one lab: a lab's key is not valid for another lab, and a witness' key not for a
        lab."""
        return [key for key in self.keys if key.name == origin and key.kind == SIGNS]

    def find_signers(self, note: Note, head: TreeHead) -> list[PublicKey]:
        """The keys of the checkpoint's lab that have signed it. Raises BadInput."""
        signed = note.find_signers(self.list_for(head.origin))
        return [key for key in signed if head.size <= self._ended.get(key.text, head.size)]


def _parse_rotation(note: Note) -> tuple[int, PublicKey, PublicKey]:
    lines = note.text.splitlines()
    if len(lines) != 5 or lines[0] != ROTATION or not lines[1].isdecimal():
        raise BadInput("This is not a change of a key.", remedy="Use the file rotation.notes of the lab.")
    return int(lines[1]), parse_public_key(lines[2]), parse_public_key(lines[3])


def parse_rotations(data: bytes) -> tuple[Note, ...]:
    """Raises BadInput."""
    return tuple(parse_note(part + b"\n") for part in data.removesuffix(b"\n").split(_BETWEEN) if part)


def encode_rotations(notes: Iterable[Note]) -> bytes:
    return _BETWEEN.join(note.encode().removesuffix(b"\n") for note in notes) + b"\n"


def read_public_keys(path: Path) -> list[PublicKey]:
    """The keys in a file, one a line. Raises BadInput."""
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(
            f"The public key {path} cannot be read: {error}.", remedy="Name another file."
        ) from None
    return [parse_public_key(line) for line in lines if line.strip()]


def read_given_keys(arguments: Sequence[str]) -> list[PublicKey]:
    """Public keys as arguments of a command: each is a file or the key itself. Raises BadInput."""
    found: list[PublicKey] = []
    for each in arguments:
        found.extend(read_public_keys(Path(each)) if Path(each).is_file() else [parse_public_key(each)])
    return found
