"""The words of a command, stored beside the log before the command is decided.

The decision uses only references. So an event, a longer sentence or a question that contains the text
contains the reference too. Words that LabOS writes itself (``ended``) are stored as they are.
"""

from __future__ import annotations

import typing
from collections.abc import Iterator
from functools import cache
from typing import Any, TypeVar

import msgspec

from labos.core.words import Keep, find_fields_of_words

S = TypeVar("S", bound=msgspec.Struct)


def list_words(command: msgspec.Struct) -> Iterator[tuple[str, str]]:
    """The texts that a person may have written in a command, each with its field."""
    for name, _ in _find_own_words(type(command)):
        if text := getattr(command, name):
            yield text, name
    for name in _find_holders(type(command)):
        value = getattr(command, name)
        for part in value if isinstance(value, tuple) else (value,):
            yield from list_words(part)


def refer_to_words(command: S, keep: Keep) -> S:
    """The command with a reference instead of each text that a person wrote."""
    changed: dict[str, Any] = {}
    for name, own in _find_own_words(type(command)):
        text = getattr(command, name)
        if text and text != own and not text.isspace():
            changed[name] = keep(text)
    for name in _find_holders(type(command)):
        value = getattr(command, name)
        if isinstance(value, tuple):
            changed[name] = tuple(refer_to_words(part, keep) for part in value)
        else:
            changed[name] = refer_to_words(value, keep)
    return msgspec.structs.replace(command, **changed) if changed else command


@cache
def _find_own_words(kind: type[msgspec.Struct]) -> tuple[tuple[str, Any], ...]:
    """The fields that hold words, and the value of each when it is empty."""
    named = find_fields_of_words(kind)
    return tuple((each.name, each.default) for each in msgspec.structs.fields(kind) if each.name in named)


@cache
def _find_holders(kind: type[msgspec.Struct]) -> tuple[str, ...]:
    """The fields that hold structures with words."""
    hints = typing.get_type_hints(kind)
    return tuple(
        name for name in kind.__struct_fields__ if any(map(_holds_words, _list_structs(hints[name])))
    )


@cache
def _holds_words(kind: type[msgspec.Struct]) -> bool:
    return bool(find_fields_of_words(kind) or _find_holders(kind))


def _list_structs(hint: Any) -> list[type[msgspec.Struct]]:
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return [hint]
    return [found for inner in typing.get_args(hint) for found in _list_structs(inner)]
