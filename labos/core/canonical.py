"""Canonical JSON: one value, one sequence of bytes.

Keys are sorted, there is no white space, and numbers that are not finite are refused
(RFC 8259 has no spelling for them).
"""

from __future__ import annotations

import hashlib
import math
from typing import Any

import msgspec

_encoder = msgspec.json.Encoder(order="sorted")


def canonical(value: Any) -> bytes:
    """Encode a JSON value or a msgspec Struct. Raises ValueError for NaN and infinities."""
    data = _encoder.encode(value)
    if b"null" in data:  # which is how the encoder spells a number that is not finite
        refuse_non_finite(value)
    return data


def refuse_non_finite(value: Any) -> None:
    """Raise ValueError if a float somewhere in the value is not finite."""
    kind = type(value)
    if kind is float:
        if not math.isfinite(value):
            raise ValueError(f"{value} is not a finite number and cannot be recorded.")
    elif isinstance(value, dict):
        for item in value.values():
            refuse_non_finite(item)
    elif isinstance(value, list | tuple | set | frozenset):
        for item in value:
            refuse_non_finite(item)
    elif isinstance(value, msgspec.Struct):
        for field in value.__struct_fields__:
            refuse_non_finite(getattr(value, field))


def digest(data: bytes) -> str:
    """SHA-256 as 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()
