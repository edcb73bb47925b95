"""Words: texts that a person wrote into an event for other people. No decision depends on them.

They are stored beside the log, so that they can be erased. The event contains a reference instead: the digest
of a salt and the text. With the salt and the text one can verify that they are the original. From the
reference alone nobody can guess even a short text. Older events contain the text itself.
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
"""The type of a field for a reason, note or comment that a person may have written. Names, tags, facts and
ids are data, not words: others look them up, and decisions may depend on them."""

PREFIX = "words:"
"""The beginning of a reference; 64 hexadecimal digits follow."""

ERASED = "(erased)"
"""The text that is shown instead of erased words."""

_MARK = PREFIX.encode()
_REFERENCE = re.compile(rb"words:[0-9a-f]{64}")

Keep = Callable[[str], str]
"""Stores a text beside the log, and returns the reference that replaces it."""


class Kept(msgspec.Struct, frozen=True):
    """A text that is stored beside the log. ``salt`` are 16 random bytes; both are empty if the text was
    erased."""

    reference: str
    salt: bytes
    text: str

    @property
    def is_erased(self) -> bool:
        return not self.salt

    @property
    def is_genuine(self) -> bool:
        """Whether this is the original text, or it was erased."""
        return self.is_erased or make_reference(self.salt, self.text) == self.reference


def keep(text: str, salt: bytes) -> Kept:
    return Kept(make_reference(salt, text), salt, text)


def make_reference(salt: bytes, text: str) -> str:
    """The reference to a text in an event."""
    return PREFIX + hashlib.sha256(salt + text.encode()).hexdigest()


def list_references(data: bytes) -> list[str]:
    """The references in a payload, or in any other bytes; each once, in their order."""
    if _MARK not in data:
        return []
    return list(dict.fromkeys(found.decode() for found in _REFERENCE.findall(data)))


def put_into_json(data: bytes, texts: Mapping[str, str]) -> bytes:
    """JSON with texts instead of their references. A reference without a text was erased."""

    def put(found: re.Match[bytes]) -> bytes:
        return msgspec.json.encode(texts.get(found[0].decode(), ERASED))[1:-1]

    return _REFERENCE.sub(put, data)


def put_into_text(text: str, texts: Mapping[str, str]) -> str:
    """The same for a plain text."""
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
