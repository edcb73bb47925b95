"""Divides texts into words for the search index, so that both databases find the same."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from typing import Any

LONGEST_WORD = 100
MOST_WORDS = 500
"""The largest number of different words of one entry."""

_WORD = re.compile(r"[^\W_]+")


def words_of(text: str) -> list[str]:
    """The words of a text in their order: letters and digits, in lower case, without accents. ``Café
    cp_mixcolor R1#3`` has the words cafe, cp, mixcolor, r1, 3."""
    plain = unicodedata.normalize("NFKD", text[: 100 * MOST_WORDS])
    plain = "".join(char for char in plain if not unicodedata.combining(char)).casefold()
    return [word[:LONGEST_WORD] for word in _WORD.findall(plain)]


def join_words(values: Iterable[Any]) -> str:
    """The words of all texts in these values, at any depth, each once, with a space between them."""
    found: dict[str, bool] = {}
    for text in _iterate_texts(values):
        for word in words_of(text):
            found[word] = True
            if len(found) >= MOST_WORDS:
                return " ".join(found)
    return " ".join(found)


def _iterate_texts(value: Any) -> Iterable[str]:
    """All texts and numbers in a value, names of members too."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for name, item in value.items():
            yield str(name)
            yield from _iterate_texts(item)
    elif isinstance(value, bool) or value is None:
        return
    elif isinstance(value, int | float):
        yield f"{value:.10g}" if isinstance(value, float) else str(value)
    elif isinstance(value, Iterable):
        for item in value:
            yield from _iterate_texts(item)
