"""The words beside the log: they are written with their events, read, and erased."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from sqlalchemy import Connection, or_, select

from labos.core.envelope import Record
from labos.core.erasure import list_erased
from labos.core.users import ON_BEHALF
from labos.core.words import Kept
from labos.ports import Row, StoredWords
from labos.store._backend import WordChanges
from labos.store._tables import event, words

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
            found[row.reference] = _read_kept(row)
    return found


def read_all_words(connection: Connection, after: str, limit: int) -> list[StoredWords]:
    """The next words after a reference, in the order of their references."""
    query = select(words).where(words.c.reference > after).order_by(words.c.reference).limit(limit)
    return [StoredWords(_read_kept(row), row.position, row.erased_at) for row in connection.execute(query)]


def read_words_by(connection: Connection, user: str) -> list[tuple[int, str]]:
    """Positions and references of the words of a user that were not erased."""
    theirs = or_(event.c.actor == user, event.c.actor.endswith(f"{ON_BEHALF}{user}", autoescape=True))
    query = (
        select(words.c.position, words.c.reference)
        .join(event, event.c.position == words.c.position)
        .where(words.c.erased_at == 0, theirs)
        .order_by(words.c.position)
    )
    return [(row.position, row.reference) for row in connection.execute(query)]


def read_erased(connection: Connection) -> dict[str, int]:
    """The references of all erased words, and the positions of the erasing events."""
    query = select(words.c.reference, words.c.erased_at).where(words.c.erased_at > 0)
    return {row.reference: row.erased_at for row in connection.execute(query)}


def row_of(each: StoredWords) -> Row:
    """The row for restored words."""
    return each.words.reference, each.position, each.words.salt, each.words.text, each.erased_at


def _read_kept(row: Any) -> Kept:
    salt, text = row.salt, row.text
    if not isinstance(salt, bytes | memoryview) or not isinstance(text, str):
        # SQLite allows values of any type in a column; a wrong value is detected by its digest.
        return Kept(row.reference, str(salt).encode(), str(text))
    return Kept(row.reference, bytes(salt), text)
