"""The part of a log that every query needs, and how a stored record becomes an event."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Protocol

import msgspec

from labos.core.envelope import Envelope, Record
from labos.core.fold import evolve
from labos.core.registry import Event, decode
from labos.core.state import LabState, fold_fingerprint, from_picture
from labos.core.words import Kept
from labos.errors import LogDamaged
from labos.ports import Head, LogQuery

Row = tuple[Any, ...]
VERIFY = "Find the first bad position with: labos verify"


class Log(Protocol):
    """The reading part of an event store."""

    def head(self) -> Head: ...

    def read(self, after: int = 0, upto: int | None = None) -> Iterator[Record]: ...

    def replay(self, after: int = 0, upto: int | None = None) -> Iterator[Row]:
        """(position, type, schema, recorded_at, payload) of each record."""

    def select(self, query: LogQuery) -> Iterator[Record]: ...

    def load_snapshot(self, fingerprint: str) -> tuple[int, bytes, bytes] | None: ...

    def words_of(self, references: Iterable[str]) -> Mapping[str, Kept]:
        """The words that are stored beside the log for these references."""


def decode_event(record: Record) -> Event:
    """The event of a record. Raises LogTooNew, LogDamaged."""
    head = record.head
    try:
        return decode(head.type, head.schema, record.payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, TypeError) as error:
        raise _make_unreadable_error(head.position, error) from None


def decode_events(records: Iterable[Record]) -> Iterator[tuple[Event, Envelope]]:
    """Every event with its envelope. Raises LogTooNew, LogDamaged."""
    for record in records:
        yield decode_event(record), record.head


def fold_to(log: Log, position: int) -> LabState:
    """The state after the event at a position; folding begins with the newest usable snapshot. Raises
    LogTooNew, LogDamaged."""
    state = LabState()
    found = log.load_snapshot(fold_fingerprint())
    if found is not None and found[0] <= position:
        state = from_picture(found[2])
    for row in log.replay(state.position, position):
        try:
            evolve(state, decode(row[1], row[2], row[4]), row[0], row[3])
        except (msgspec.MsgspecError, TypeError, KeyError, ValueError, IndexError) as error:
            raise _make_unreadable_error(row[0], error) from None
    return state


def _make_unreadable_error(position: int, error: Exception) -> LogDamaged:
    return LogDamaged(
        f"The record at position {position} contradicts the log ({error}).", position=position, remedy=VERIFY
    )
