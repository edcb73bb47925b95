"""The words beside the log: they are written with their events, read, and erased."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from sqlalchemy import Connection, select

from labos.core.envelope import Record
from labos.core.erasure import list_erased
from labos.core.words import Kept
from labos.ports import Row, StoredWords
from labos.store._backend import WordChanges
from labos.store._tables import words

_AT_ONCE = 500
"""The number of references that one statement looks up."""


NOTHING = WordChanges()


def make_changes(records: Sequence[Record]) -> WordChanges:
    """The changes of words that have to be written with records."""
    added = [
        (kept.reference, record.head.position, kept.salt, kept.text, 0)
        for record in records
        if record.words
        for kept in record.words
    ]
    erased = [
        (b"", record.head.position, reference)
        for record in records
        for reference in list_erased(record.head.type, record.head.schema, record.payload)
    ]
    return WordChanges(added, erased) if added or erased else NOTHING


def read_words(connection: Connection, references: Iterable[str]) -> dict[str, Kept]:
    """The words of references, including erased ones. References without words are left out."""
    named = list(references)
    found: dict[str, Kept] = {}
    for begin in range(0, len(named), _AT_ONCE):
        some = words.c.reference.in_(named[begin : begin + _AT_ONCE])
        for row in connection.execute(select(words.c.reference, words.c.salt, words.c.text).where(some)):
            found[row.reference] = read_kept(row)
    return found


def read_erased(connection: Connection) -> dict[str, int]:
    """The references of all erased words, and the positions of the erasing events."""
    query = select(words.c.reference, words.c.erased_at).where(words.c.erased_at > 0)
    return {row.reference: row.erased_at for row in connection.execute(query)}


def row_of(each: StoredWords) -> Row:
    """The row for restored words."""
    return each.words.reference, each.position, each.words.salt, each.words.text, each.erased_at


def read_kept(row: Any) -> Kept:
    """The words of a row."""
    salt, text = row.salt, row.text
    if not isinstance(salt, bytes | memoryview) or not isinstance(text, str):
        # SQLite allows values of any type in a column; a wrong value is detected by its digest.
        return Kept(row.reference, str(salt).encode(), str(text))
    return Kept(row.reference, bytes(salt), text)
