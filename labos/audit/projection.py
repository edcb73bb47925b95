"""Converts events to rows: a plain function of the log, with no memory except the rows."""

from __future__ import annotations

from typing import Any

from labos.audit import (
    _approvals,
    _bench,
    _campaigns,
    _entries,
    _liquids,
    _people,
    _work,
)
from labos.audit._bench import list_touched
from labos.audit._bench_tables import TOUCHES
from labos.audit._rows import RowChanges, convert_to_seconds
from labos.audit._work_tables import EVENTS
from labos.core import fold
from labos.core.envelope import Record
from labos.core.labware import SamplesRegistered
from labos.core.registry import TYPES, Event, list_handlers
from labos.ports import BlobStore
from labos.services.log import decode_event

assert fold  # it registers the events

_NAMED = ("run", "step", "module", "action", "labware")
_UNNAMED = ("", None, "", "", "")
_KNOWN: dict[type[Event], list[tuple[int, str]]] = {
    kind: [(at, name) for at, name in enumerate(_NAMED) if name in kind.__struct_fields__]
    for kind in TYPES.values()
}
"""The columns of ``events`` that each type of event fills."""

_SLICES = (_work, _bench, _liquids, _people, _campaigns, _approvals, _entries)

_FOUND = [list_handlers(vars(slice_), RowChanges, "on_", ("event", "head", "at")) for slice_ in _SLICES]

_HANDLERS = {kind: [found[kind] for found in _FOUND if kind in found] for kind in TYPES.values()}


class Projection:
    """Processes events of a log in their order; ``blobs`` contain long sample sheets."""

    def __init__(self, rows: RowChanges, blobs: BlobStore | None = None) -> None:
        self.rows, self.blobs = rows, blobs

    def take(self, record: Record) -> None:
        """Process one record. Raises LogTooNew, LogDamaged."""
        event, head, rows = decode_event(record), record.head, self.rows
        kind = type(event)
        at = convert_to_seconds(head.recorded_at)
        if b"\\u0000" in record.payload:
            rows.may_have_nul = True
        about = (head.position, at, head.type, head.actor, head.stream, head.correlation)
        named: list[Any] = list(_UNNAMED)
        for place, name in _KNOWN[kind]:
            named[place] = getattr(event, name)
        if type(named[4]) is tuple:  # for several pieces of labware, none is named
            named[4] = ""
        rows.add(EVENTS, *about, *named, head.id)
        for handler in _HANDLERS[kind]:
            handler(rows, event, head, at)
        if isinstance(event, SamplesRegistered):
            before = _entries.samples_of(rows, event.labware)
            _liquids.on_samples_registered(rows, event, head, at, self.blobs)
            _entries.on_samples_registered(rows, event, head, at, before)
        _people.note_actor(rows, head, at)
        for name in list_touched(rows, event):
            rows.add(TOUCHES, name, head.position)
