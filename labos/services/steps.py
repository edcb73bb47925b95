"""Reads a log event by event, and lists the changes of the state by each event."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import msgspec

from labos.core.envelope import Record
from labos.core.fold import evolve
from labos.core.registry import Event
from labos.core.state import LabState
from labos.errors import LogDamaged
from labos.services.log import VERIFY, decode_event

PAST_COUNTERS = ("position", "recorded_at", "versions")
"""Fields that every event changes; they are not listed."""

_ABSENT = "absent"


class StateChange(msgspec.Struct, frozen=True):
    """A place in the state, its value before and its value now; a value that does not exist is ``absent``."""

    path: str
    before: Any
    after: Any


class LogStep(msgspec.Struct, frozen=True):
    """An event and the changes that it made."""

    record: Record
    event: Event
    changes: list[StateChange]


def make_plain_state(state: LabState) -> dict[str, Any]:
    """The state as JSON values."""
    built: dict[str, Any] = msgspec.to_builtins(state, str_keys=True)
    return built


def iterate_steps(
    records: Iterable[Record], state: LabState, first: int, last: int | None
) -> Iterator[LogStep]:
    """Fold records into a state; yields each from ``first`` to ``last`` with its changes. Raises
    LogTooNew, LogDamaged."""
    seen: dict[str, Any] | None = None
    for record in records:
        position = record.head.position
        if last is not None and position > last:
            return
        if position >= first and seen is None:
            seen = make_plain_state(state)
        event = decode_event(record)
        try:
            evolve(state, event, position, record.head.recorded_at)
        except (TypeError, KeyError, ValueError, IndexError) as error:
            raise LogDamaged(
                f"The record at position {position} contradicts the log ({error!r}).",
                position=position,
                remedy=VERIFY,
            ) from None
        if seen is not None:
            now = make_plain_state(state)
            yield LogStep(record, event, list(list_changes(seen, now)))
            seen = now


def list_changes(before: Any, after: Any, path: str = "") -> Iterator[StateChange]:
    """The differences between two states, or two values at a path, without the fields that every event
    changes."""
    if before == after:
        return
    if isinstance(before, dict) and isinstance(after, dict):
        for key in (*before, *(k for k in after if k not in before)):
            if path or key not in PAST_COUNTERS:
                place = f"{path}.{key}" if path else key
                yield from list_changes(before.get(key, _ABSENT), after.get(key, _ABSENT), place)
    else:
        yield StateChange(path, before, after)
