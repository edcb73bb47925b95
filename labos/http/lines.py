"""A record of the log in the form that HTTP sends."""

from __future__ import annotations

import msgspec

from labos.core.envelope import Record
from labos.core.structs import make_from
from labos.ports import EventLine
from labos.services.times import iso_time


def line_of(record: Record) -> EventLine:
    """The line of a record."""
    head = record.head
    return make_from(
        EventLine,
        head,
        time=iso_time(head.recorded_at),
        payload=msgspec.Raw(record.payload),
        hash=record.hash.hex(),
    )
