"""Signed notes and keys: what is taken, and what is not."""

from __future__ import annotations

import base64
import os
from pathlib import Path

import pytest

from labos.core.merkle import EMPTY_ROOT
from labos.errors import BadInput, Refused
from labos.services.trust.checkpoints import TreeHead, parse_tree_head, sign_tree
from labos.services.trust.keys import (
    SigningKeys,
    TrustedKeys,
    encode_rotations,
    parse_rotations,
    read_given_keys,
)
from labos.services.trust.notes import (
    COSIGNS,
    SIGNS,
    Note,
    make_key,
    parse_note,
    parse_public_key,
    parse_signing_key,
)

KEY = make_key("example.org/lab", SIGNS, bytes(range(32)))
OTHER = make_key("example.org/lab", SIGNS, bytes(32))
HEAD = TreeHead("example.org/lab", 0, EMPTY_ROOT)

SPECIFIED = """\
If you think cryptography is the answer to your problem,
then you don't know what your problem is.

— PeterNeumann x08go/ZJkuBS9UG/SffcvIAQxVBtiFupLLr8pAcElZInNIuGUgYN1FFYC2pZSNXgKvqfqdngotpRZb6KE6RyyBwJnAM=
"""
"""The example of Go's documentation of signed notes, with its key."""
PETER = "PeterNeumann+c74f20a3+ARpc2QcUPDhMQegwxbzhKqiBfsVkmqq/LDE4izWy10TW"


def test_the_example_of_go_verifies() -> None:
    note = parse_note(SPECIFIED.encode())
    assert note.encode() == SPECIFIED.encode()
    key = parse_public_key(PETER)
    assert key.text == PETER
    assert note.find_signers([key]) == [key]


def test_a_note_is_read_as_it_was_written() -> None:
    note = sign_tree(HEAD, KEY)
    assert parse_note(note.encode()) == note
    assert parse_tree_head(note.text) == HEAD
    assert note.find_signers([KEY.public, OTHER.public]) == [KEY.public]


def test_a_changed_text_is_not_what_was_signed() -> None:
    data = sign_tree(HEAD, KEY).encode().replace(b"\n0\n", b"\n1\n")
    with pytest.raises(BadInput, match=r"signature of example\.org/lab does not match"):
        parse_note(data).find_signers([KEY.public])


def test_a_cosignature_tells_its_time() -> None:
    witness = make_key("w", COSIGNS, bytes(32))
    signature = witness.sign(HEAD.text, 1_679_315_147)
    note = Note(HEAD.text, (KEY.sign(HEAD.text), signature))
    assert note.find_signers([witness.public, KEY.public]) == [witness.public, KEY.public]
    assert signature.time_s == 1_679_315_147
    later = (signature.time_s + 1).to_bytes(8) + signature.raw[8:]
    assert not witness.public.verifies(HEAD.text.encode(), later)
    assert not witness.public.verifies(HEAD.text.encode(), signature.raw[:-1])


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\n\n",
        b"text\n",
        b"text\n\nno dash\n",
        "text\n\n— name ?\n".encode(),
        "text\n\n— name AAAA\n".encode(),
        "text\n\n— name AAAAAAAA".encode(),
        "te\x07xt\n\n— name AAAAAAAA\n".encode(),
        b"\xff\n\n",
        b"x" * 70_000,
        ("text\n\n" + "— name AAAAAAAA\n" * 65).encode(),
    ],
)
def test_what_is_no_note_is_refused(data: bytes) -> None:
    with pytest.raises(BadInput, match="not a signed note"):
        parse_note(data)


@pytest.mark.parametrize(
    "text", ["", "a\n1\n", "a\n01\nAAAA\n", "a\n-1\n" + "A" * 43 + "=\n", "a\n1\nAAAA\n"]
)
def test_what_is_no_checkpoint_is_refused(text: str) -> None:
    with pytest.raises(BadInput, match="not a checkpoint"):
        parse_tree_head(text)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "name",
        "name+00000000+AAAA",
        KEY.public.text.replace("example.org", "example.com"),
        "name+zz+" + base64.b64encode(bytes(33)).decode(),
        " +00000000+" + base64.b64encode(b"\x01" + bytes(32)).decode(),
    ],
)
def test_what_is_no_key_is_refused(text: str) -> None:
    with pytest.raises(BadInput):
        parse_public_key(text)
    with pytest.raises(BadInput):
        parse_signing_key("PRIVATE+KEY+" + text)


def test_a_private_key_does_not_show_itself() -> None:
    secret = base64.b64encode(b"\x01" + KEY.seed).decode()
    assert secret in KEY.text
    assert secret not in repr(KEY)
    assert repr(KEY.seed) not in repr(KEY)


# -- keys in a lab's folder ---------------------------------------------------------------------


def test_a_key_is_made_once_and_is_private(tmp_path: Path) -> None:
    keys = SigningKeys(tmp_path)
    public = keys.create("example.org/lab")
    assert keys.read_signing_key().public == public == keys.list_public_keys()[-1]
    if os.name != "nt":
        modes = [path.stat().st_mode & 0o777 for path in (keys.folder, *keys.folder.iterdir())]
        assert modes == [0o700, 0o600, 0o600]
    with pytest.raises(Refused, match="already has a key"):
        keys.create("example.org/lab")
    with pytest.raises(BadInput, match="cannot be the name"):
        SigningKeys(tmp_path / "other").create("a lab")


def test_who_trusts_an_old_key_goes_on_with_its_successors(tmp_path: Path) -> None:
    keys = SigningKeys(tmp_path)
    first = keys.create("example.org/lab")
    old = keys.read_signing_key()
    keys.rotate(10, "2026-05-04T10:00:00Z")
    keys.rotate(20, "2026-05-05T10:00:00Z")
    third = keys.read_signing_key()
    rotations = parse_rotations(encode_rotations(keys.read_rotations()))
    assert rotations == keys.read_rotations()
    assert len(rotations) == 2
    trusted = TrustedKeys([first], rotations)
    assert trusted.keys == keys.list_public_keys()
    at_30 = TreeHead("example.org/lab", 30, bytes(32))
    assert trusted.find_signers(sign_tree(at_30, third), at_30) == [third.public]
    assert trusted.find_signers(sign_tree(at_30, old), at_30) == [], "it was to sign nothing behind 10"
    at_10 = TreeHead("example.org/lab", 10, bytes(32))
    assert trusted.find_signers(sign_tree(at_10, old), at_10) == [first]
    assert TrustedKeys([OTHER.public], rotations).keys == [OTHER.public]


def test_nobody_else_names_a_successor(tmp_path: Path) -> None:
    keys = SigningKeys(tmp_path)
    first = keys.create("example.org/lab")
    note = keys.rotate(10, "2026-05-04T10:00:00Z")
    only_new = Note(note.text, note.signatures[1:])
    with pytest.raises(BadInput, match="not signed by both"):
        TrustedKeys([first], [only_new])
    text = note.text.replace("\n10\n", "\n99\n")
    with pytest.raises(BadInput, match="was changed"):
        TrustedKeys([first], [Note(text, note.signatures)])


def test_no_lab_speaks_for_another_and_no_witness_for_a_lab() -> None:
    foreign = make_key("example.org/other", SIGNS, bytes(32))
    witness = make_key("example.org/lab", COSIGNS, bytes(32))
    note = Note(HEAD.text, (foreign.sign(HEAD.text), witness.sign(HEAD.text, 1)))
    assert TrustedKeys([foreign.public, witness.public]).find_signers(note, HEAD) == []


def test_keys_are_given_as_text_or_as_files(tmp_path: Path) -> None:
    file = tmp_path / "lab.pub"
    file.write_text(f"{KEY.public.text}\n\n{OTHER.public.text}\n")
    assert read_given_keys([str(file), PETER]) == [KEY.public, OTHER.public, parse_public_key(PETER)]
