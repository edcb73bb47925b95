"""Durations as people write them: ``90``, ``"90 s"``, ``"10 min"``, ``"12 h"``."""

from __future__ import annotations

import re
from typing import Any

SECONDS = {
    "ms": 0.001,
    "s": 1.0,
    "sec": 1.0,
    "second": 1.0,
    "seconds": 1.0,
    "min": 60.0,
    "minute": 60.0,
    "minutes": 60.0,
    "h": 3600.0,
    "hour": 3600.0,
    "hours": 3600.0,
    "d": 86400.0,
    "day": 86400.0,
    "days": 86400.0,
}

QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\s\d].*?)?\s*")

LONGEST = 100


def match_quantity(text: str) -> re.Match[str] | None:
    """A number and its unit; None for other texts and for long ones, which are not searched."""
    return QUANTITY.fullmatch(text) if len(text) <= LONGEST else None


def parse_duration(value: Any) -> float:
    """The duration in seconds. Raises ValueError for a value that is not a duration."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    if isinstance(value, str):
        match = match_quantity(value)
        if match:
            number, unit = float(match[1]), match[2] or "s"
            if unit in SECONDS:
                return number * SECONDS[unit]
            raise ValueError(f"the unit {unit!r} is not known; write s, min, h or d")
    raise ValueError("a duration is a number of seconds or text such as '10 min', '12 h' or '90 s'")
