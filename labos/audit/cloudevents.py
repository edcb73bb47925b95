"""Events of the log in the envelope of CloudEvents 1.0, for programs that support it: JSON, structured mode.

Attributes are those of the specification (https://github.com/cloudevents/spec, version 1.0.2); its extensions
have names with lower-case letters and digits. ``position`` is text, because whole numbers of CloudEvents end
at 2³¹ − 1.
"""

from __future__ import annotations

from typing import Any
from urllib.parse import quote

import msgspec

from labos.audit.formats import NAMESPACE
from labos.core.envelope import Record
from labos.services.times import iso_time

PREFIX = "labos."
"""The prefix of every type, which distinguishes it from types of other programs."""


def source_of(lab: str) -> str:
    """The lab as the source of its events."""
    return f"{NAMESPACE}{quote(lab, safe='')}"


def encode_cloudevent(record: Record) -> bytes:
    """A record as one line of JSON. ``data`` is the stored payload, in the schema of its time
    (``eventschema``); ``hash`` is the record's hash in the chain."""
    head = record.head
    attributes: dict[str, Any] = {
        "specversion": "1.0",
        "id": head.id,
        "source": source_of(head.lab),
        "type": PREFIX + head.type,
        "time": iso_time(head.recorded_at),
        "datacontenttype": "application/json",
        "position": str(head.position),
        "hash": record.hash.hex(),
        "eventschema": head.schema,
    }
    # An attribute is left out rather than empty.
    others = {
        "subject": head.stream,
        "actor": head.actor,
        "correlationid": head.correlation,
        "causationid": head.causation,
    }
    attributes.update({name: value for name, value in others.items() if value})
    return msgspec.json.encode({**attributes, "data": msgspec.Raw(record.payload)})
