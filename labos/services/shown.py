"""A log as people read it: its references are replaced by the words beside the log, or by a mark if the words
were erased.

Code that verifies, copies or folds a log reads it as it is stored.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Protocol, TypeVar

import msgspec

from labos.core.envelope import Record
from labos.core.state import rewrite_picture
from labos.core.words import PREFIX, Kept, list_references, put_into_json, put_into_text
from labos.ports import Head, Log, LogQuery, Row

PAGE = 500
"""The words of so many records are looked up in one query."""

T = TypeVar("T")
S = TypeVar("S", bound=msgspec.Struct)


class WordsBeside(Protocol):
    """A store of words."""

    def words_of(self, references: Iterable[str]) -> Mapping[str, Kept]: ...


def read_texts(log: WordsBeside, references: Iterable[str]) -> dict[str, str]:
    """The texts for references, without erased ones. Raises StoreUnavailable."""
    named = list(references)
    if not named:
        return {}
    return {name: kept.text for name, kept in log.words_of(named).items() if not kept.is_erased}


def show_json(log: WordsBeside, data: bytes) -> bytes:
    """JSON with its references replaced by words. Raises StoreUnavailable."""
    named = list_references(data)
    return put_into_json(data, read_texts(log, named)) if named else data


def show_text(log: WordsBeside, text: str) -> str:
    """Plain text with its references replaced by words. Raises StoreUnavailable."""
    return put_into_text(text, read_texts(log, list_references(text.encode())))


def show_struct(log: WordsBeside, value: S) -> S:
    """A struct with the references in all its texts replaced by words. Raises StoreUnavailable."""
    data = msgspec.json.encode(value)
    return msgspec.json.decode(show_json(log, data), type=type(value)) if list_references(data) else value


def show_records(log: WordsBeside, records: Sequence[Record]) -> list[Record]:
    """Records with the references in their payloads replaced by words. Raises StoreUnavailable."""
    named = [_list_references(record) for record in records]
    texts = read_texts(log, dict.fromkeys(name for names in named for name in names))
    return [
        msgspec.structs.replace(record, payload=put_into_json(record.payload, texts)) if names else record
        for record, names in zip(records, named, strict=True)
    ]


def _list_references(record: Record) -> list[str]:
    # SQLite lets a column hold a value of any type: the code that reads the event reports the damage.
    return list_references(record.payload) if isinstance(record.payload, bytes) else []


class ShownLog:
    """The same log, with words in place of references."""

    def __init__(self, log: Log) -> None:
        self._log = log

    def head(self) -> Head:
        return self._log.head()

    def read(self, after: int = 0, upto: int | None = None) -> Iterator[Record]:
        return self._show(self._log.read(after, upto))

    def select(self, query: LogQuery) -> Iterator[Record]:
        return self._show(self._log.select(query))

    def replay(self, after: int = 0, upto: int | None = None) -> Iterator[Row]:
        """Like the log's own method, so each record is checked before its references are replaced."""
        for rows in _split_into_pages(self._log.replay(after, upto)):
            named = [name for row in rows for name in list_references(row[4])]
            texts = read_texts(self._log, dict.fromkeys(named))
            for row in rows:
                yield (*row[:4], put_into_json(row[4], texts)) if PREFIX.encode() in row[4] else row

    def load_snapshot(self, fingerprint: str) -> tuple[int, bytes, bytes] | None:
        found = self._log.load_snapshot(fingerprint)
        if found is None or PREFIX.encode() not in found[2]:
            return found
        position, hash_, data = found
        texts = read_texts(self._log, list_references(data))
        return position, hash_, rewrite_picture(data, lambda text: put_into_text(text, texts))

    def words_of(self, references: Iterable[str]) -> Mapping[str, Kept]:
        return self._log.words_of(references)

    def _show(self, records: Iterator[Record]) -> Iterator[Record]:
        for page in _split_into_pages(records):
            yield from show_records(self._log, page)


def _split_into_pages(items: Iterator[T]) -> Iterator[list[T]]:
    while page := list(islice(items, PAGE)):
        yield page
