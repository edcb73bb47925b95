"""What a foreign device sends, read with a limit.

A reply that is too long, nested too deep or no text at all is a ``ValueError`` like any other that cannot be
read: the adapter says what that means for the action.
"""

from __future__ import annotations

import json
from typing import Any

LARGEST_JSON = 16 * 1024 * 1024
"""Bytes of JSON in an answer."""


def read_json_text(text: str | bytes) -> Any:
    """The value that a JSON text stands for. Raises ValueError."""
    if len(text) > LARGEST_JSON:
        raise ValueError(f"it has {len(text)} bytes; {LARGEST_JSON} are read")
    try:
        return json.loads(text)
    except RecursionError:
        raise TooDeep("it is nested too deep") from None


class TooDeep(ValueError):
    """Nested deeper than can be read: more of it would not help."""
