"""Answers to an agent: JSON of limited length, with the position of the next page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import msgspec

LONGEST = 24_000
"""Characters of an answer. A longer one comes in pages."""

LONGEST_VALUE = 4_000
"""Characters of one value in an answer, as JSON. A longer one is cut, with a remark."""


MOST_PARTS = 50
"""Entries of a long table or list in an answer."""


def encode_answer(data: Any, **more: Any) -> str:
    """Encode an answer. Texts of users, devices and programs are only under ``data``."""
    return msgspec.json.encode({**more, "data": data}).decode()


def page(items: Sequence[Any], place: Callable[[int], Any], *, rest: Any = None, **more: Any) -> str:
    """A page with as many items as fit, at least one. ``next`` is the parameter for the next page: ``place``
    of the first item that was left out, or ``rest`` if there is none."""
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
    """The value, with long parts cut: texts keep their beginning, and tables and lists become a remark."""
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
