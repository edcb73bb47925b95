"""Checks the whole chain and finds its first damage."""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from labos.core.envelope import GENESIS, Record, find_damage
from labos.errors import LogDamaged
from labos.ports import EventStore

Progress = Callable[[int, int], None]


class Damage(msgspec.Struct, frozen=True):
    """The first damage of a log: its position, and its description in one sentence."""

    position: int
    reason: str


def find_first_damage(
    store: EventStore, progress: Progress | None = None, *, every: int = 1000
) -> Damage | None:
    """Check every record of the log against the chain, and its end against the head.

    ``progress`` is called after each ``every`` records with (positions checked, positions to check). None
    means that the log shows no damage. If an attacker has rewritten all of it, including the head, only a
    checkpoint that was stored elsewhere can show it. Records that are appended during the check are not
    checked. Raises StoreUnavailable.
    """
    head = store.head()
    previous, position, recorded_at = GENESIS, 0, 0
    try:
        for record in store.read(0, head.position):
            if record.head.position != position + 1:
                return Damage(position + 1, "the record is missing")
            reason = _describe_damage(previous, record)
            if not reason and record.head.recorded_at < recorded_at:
                reason = "its time is before the time of the previous record"
            if reason:
                return Damage(position + 1, reason)
            previous, position, recorded_at = record.hash, position + 1, record.head.recorded_at
            if progress is not None and position % every == 0:
                progress(position, head.position)
    except LogDamaged as error:
        return Damage(error.position, "the record is missing")
    if position < head.position:
        return Damage(position + 1, f"the log ends here, but its head says {head.position}")
    if head.hash != previous:
        return Damage(position, "the head has another hash than the last record")
    extra = next(iter(store.read(position, position + 1)), None)
    if extra is not None and store.head().position <= position:
        return Damage(position + 1, f"the record is after the end by the head, which is {head.position}")
    if head.recorded_at != recorded_at:
        return Damage(position, "the head has another time than the last record")
    if progress is not None:
        progress(position, head.position)
    return None


def _describe_damage(previous: bytes, record: Record) -> str:
    try:
        return find_damage(previous, record)
    except (TypeError, ValueError) as error:
        # SQLite allows values of any type in a column.
        return f"a column holds a value of the wrong type ({error})"
