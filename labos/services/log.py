"""How a stored record becomes an event, and a log a state."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import msgspec

from labos.core.envelope import Envelope, Record
from labos.core.fold import fold_rows
from labos.core.registry import Event, decode
from labos.core.state import LabState, fold_fingerprint, from_picture
from labos.errors import LogDamaged
from labos.ports import Log as Log

VERIFY = "Find the first bad position with: labos verify"


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
    try:
        fold_rows(state, log.replay(state.position, position))
    except (msgspec.MsgspecError, TypeError, KeyError, ValueError, IndexError) as error:
        raise _make_unreadable_error(state.position + 1, error) from None
    return state


def _make_unreadable_error(position: int, error: Exception) -> LogDamaged:
    return LogDamaged(
        f"The record at position {position} contradicts the log ({error}).", position=position, remedy=VERIFY
    )
