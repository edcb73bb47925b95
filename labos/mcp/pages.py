"""Answers to an agent: JSON that fits into its reading, with the place from which to go on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import msgspec

LONGEST = 24_000
"""Characters of an answer. What is longer comes in pages."""

LONGEST_VALUE = 4_000
"""Characters of one value in an answer, as JSON; a longer one is cut, and says so."""


MOST_PARTS = 50
"""Entries of a long table or list that are told."""


def encode_answer(data: Any, **more: Any) -> str:
    """An answer. What users, devices and programs have written stands under ``data`` alone."""
    return msgspec.json.encode({**more, "data": data}).decode()


def page(items: Sequence[Any], place: Callable[[int], Any], *, rest: Any = None, **more: Any) -> str:
    """As many items as fit. ``next`` is what to ask with for those behind: by ``place`` of the first that is
    left out, ``rest`` if none is. One item is told in any case."""
    shown: list[Any] = []
    size = 0
    for number, item in enumerate(items):
        short = cut(item)
        size += len(msgspec.json.encode(short))
        if size > LONGEST and shown:
            return encode_answer(shown, next=place(number), **more)
        shown.append(short)
    return encode_answer(shown, next=rest, **more)


def cut(value: Any, longest: int = LONGEST_VALUE) -> Any:
    """The value, with long parts cut: texts to their beginning, tables and lists to a remark."""
    if isinstance(value, str):
        return value if len(value) <= longest else f"{value[:longest]}… ({len(value)} characters in all)"
    if len(msgspec.json.encode(value)) <= longest:
        return value
    if isinstance(value, dict):
        return {name: cut(part, longest // 2) for name, part in list(value.items())[:MOST_PARTS]}
    if isinstance(value, list):
        more = [f"… ({len(value)} in all)"] if len(value) > MOST_PARTS else []
        return [*(cut(part, longest // 2) for part in value[:MOST_PARTS]), *more]
    return value
