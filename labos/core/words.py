"""Words: what a person wrote into an event for other people to read. Nothing is decided by them.

They stand beside the log, so that they can be erased. In their place the event bears a reference: the digest
of a salt and the text. With text and salt one can check that they are what was written; from the reference
alone nobody can guess even a short text. Events of before bear the text itself.
"""

from __future__ import annotations

import hashlib
import re
import types
import typing
from collections.abc import Callable, Mapping
from functools import cache
from typing import Annotated, Any

import msgspec

Words = Annotated[str, msgspec.Meta(extra={"words": True})]
"""The type of a field for a reason, note or comment that a person may have written. A name, a tag, a
fact or an id is data: others look it up, and a decision may depend on it."""

PREFIX = "words:"
"""How a reference begins; 64 hexadecimal digits follow."""

ERASED = "(erased)"
"""What is shown in place of words that were erased."""

_MARK = PREFIX.encode()
_REFERENCE = re.compile(rb"words:[0-9a-f]{64}")

Keep = Callable[[str], str]
"""Puts a text beside the log, and returns the reference that takes its place."""


class Kept(msgspec.Struct, frozen=True):
    """A text as it stands beside the log. ``salt`` are 16 random bytes; both are empty if the text was
    erased."""

    reference: str
    salt: bytes
    text: str

    @property
    def is_erased(self) -> bool:
        return not self.salt

    @property
    def is_genuine(self) -> bool:
        """Whether this is the text that was written, or it was erased."""
        return self.is_erased or make_reference(self.salt, self.text) == self.reference


def keep(text: str, salt: bytes) -> Kept:
    return Kept(make_reference(salt, text), salt, text)


def make_reference(salt: bytes, text: str) -> str:
    """What stands in an event in place of a text."""
    return PREFIX + hashlib.sha256(salt + text.encode()).hexdigest()


def list_references(data: bytes) -> list[str]:
    """The references in a payload, or in any other bytes; each once, in their order."""
    if _MARK not in data:
        return []
    return list(dict.fromkeys(found.decode() for found in _REFERENCE.findall(data)))


def put_into_json(data: bytes, texts: Mapping[str, str]) -> bytes:
    """JSON with texts in the place of their references; a reference without a text was erased."""

    def put(found: re.Match[bytes]) -> bytes:
        return msgspec.json.encode(texts.get(found[0].decode(), ERASED))[1:-1]

    return _REFERENCE.sub(put, data)


def put_into_text(text: str, texts: Mapping[str, str]) -> str:
    """The same for plain text."""
    if PREFIX not in text:
        return text
    return re.sub(_REFERENCE.pattern.decode(), lambda found: texts.get(found[0], ERASED), text)


def are_words(hint: Any) -> bool:
    """Whether a field of this type (with its annotations) holds words, or may."""
    if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union:
        return any(map(are_words, typing.get_args(hint)))
    return any(
        isinstance(meta, msgspec.Meta) and bool(meta.extra and meta.extra.get("words"))
        for meta in getattr(hint, "__metadata__", ())
    )


@cache
def find_fields_of_words(kind: type[msgspec.Struct]) -> tuple[str, ...]:
    """The fields of an event's or a command's type that hold words."""
    hints = typing.get_type_hints(kind, include_extras=True)
    return tuple(name for name in kind.__struct_fields__ if are_words(hints[name]))
