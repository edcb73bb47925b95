"""Reads CloudEvents from standard input, one a line, with the library `cloudevents`; prints JSON."""

from __future__ import annotations

import json
import sys

from cloudevents.core.formats.json import JSONFormat
from cloudevents.core.v1.event import CloudEvent

for line in sys.stdin.buffer:
    event = JSONFormat().read(CloudEvent, line)
    attributes = event.get_attributes()
    print(json.dumps({**attributes, "time": attributes["time"].isoformat(), "data": event.get_data()}))
