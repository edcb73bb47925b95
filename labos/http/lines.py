"""A record of the log as HTTP sends it."""

from __future__ import annotations

import msgspec

from labos.core.envelope import Record
from labos.ports import EventLine
from labos.services.times import iso_time


def line_of(record: Record) -> EventLine:
    """The line of a record."""
    head = record.head
    return EventLine(
        position=head.position,
        time=iso_time(head.recorded_at),
        recorded_at=head.recorded_at,
        type=head.type,
        schema=head.schema,
        version=head.version,
        stream=head.stream,
        actor=head.actor,
        correlation=head.correlation,
        causation=head.causation,
        id=head.id,
        payload=msgspec.Raw(record.payload),
        hash=record.hash.hex(),
    )
