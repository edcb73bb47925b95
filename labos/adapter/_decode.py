"""Reads replies of foreign devices with limits. A reply that is too long, nested too deeply or not text
raises ``ValueError``, like any other unreadable reply. The adapter decides what this means for the action.
"""

from __future__ import annotations

import json
from typing import Any

LARGEST_JSON = 16 * 1024 * 1024
"""Bytes of JSON in an answer."""


def read_json_text(text: str | bytes) -> Any:
    """The value of a JSON text. Raises ValueError."""
    if len(text) > LARGEST_JSON:
        raise ValueError(f"it has {len(text)} bytes; {LARGEST_JSON} are read")
    try:
        return json.loads(text)
    except RecursionError:
        raise TooDeep("it is nested too deep") from None


class TooDeep(ValueError):
    """The value is nested too deeply to be read, also if more data came."""
