"""An event as it is told over HTTP."""

from __future__ import annotations

from typing import Any

import msgspec

from labos.core.envelope import Record
from labos.services.times import iso_time


def event(record: Record) -> dict[str, Any]:
    """A record as plain data, for JSON."""
    head = record.head
    return {
        "position": head.position,
        "time": iso_time(head.recorded_at),
        "recorded_at": head.recorded_at,
        "type": head.type,
        "schema": head.schema,
        "version": head.version,
        "stream": head.stream,
        "actor": head.actor,
        "correlation": head.correlation,
        "causation": head.causation,
        "id": head.id,
        "payload": msgspec.Raw(record.payload),
    }
