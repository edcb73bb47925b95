"""Words: what a person wrote into an event for other people to read. Nothing is decided by them."""

from __future__ import annotations

import typing
from typing import Annotated, Any

import msgspec

Words = Annotated[str, msgspec.Meta(extra={"words": True})]
"""The type of a field for a reason, note or comment that a person may have written. A name, a tag, a
fact or an id is data: others look it up, and a decision may depend on it."""


def are_words(hint: Any) -> bool:
    """Whether a field of this type (with its annotations) holds words."""
    return any(
        isinstance(meta, msgspec.Meta) and bool(meta.extra and meta.extra.get("words"))
        for meta in getattr(hint, "__metadata__", ())
    )


def fields_of_words(kind: type[msgspec.Struct]) -> tuple[str, ...]:
    """The fields of an event's type that hold words."""
    hints = typing.get_type_hints(kind, include_extras=True)
    return tuple(name for name in kind.__struct_fields__ if are_words(hints[name]))
