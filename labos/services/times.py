"""Reads and writes times for people; internally, times are UTC nanoseconds."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta, tzinfo
from typing import Any

import msgspec

from labos.errors import BadInput

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_UNITS = {"d": 86400, "h": 3600, "m": 60, "min": 60, "s": 1}
_RELATIVE = re.compile(r"-((?:\d+(?:\.\d+)?\s*(?:d|h|min|m|s)\s*)+)")
_PART = re.compile(r"(\d+(?:\.\d+)?)\s*(d|h|min|m|s)")
_FRACTION = re.compile(r"(:\d\d)[.,](\d{1,9})\d*")
EXAMPLES = "Write 2026-05-04T10:30 (local time), 2026-05-04T08:30Z, -2h, -90s or now."


class Moment(msgspec.Struct, frozen=True):
    """A position of the log, or a time; if neither is set, the end of the log."""

    position: int | None = None
    at_ns: int | None = None


def parse_time(text: str, now_ns: int, zone: tzinfo | None = None) -> int:
    """ISO 8601 with a time zone, or without (then in ``zone``, by default that of this computer), ``now``, or
    relative to now: ``-2h``, ``-1d12h``, ``-90s``. Raises BadInput."""
    text = text.strip()
    if text == "now":
        return now_ns
    relative = _RELATIVE.fullmatch(text)
    if relative:
        parts = _PART.findall(relative[1])
        return now_ns - sum(int(float(number) * _UNITS[unit] * 1e9) for number, unit in parts)
    fraction = _FRACTION.search(text)
    whole = _FRACTION.sub(r"\1", text)
    try:
        found = datetime.fromisoformat(whole)
        if found.tzinfo is None:
            found = found.replace(tzinfo=zone) if zone else found.astimezone()
        since = found - _EPOCH
    except (ValueError, OverflowError, OSError):
        raise BadInput(f"{text!r} is not a time.", remedy=EXAMPLES) from None
    part = int(fraction[2].ljust(9, "0")) if fraction else 0
    return (since.days * 86400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000 + part


def parse_until(text: str, now_ns: int) -> int:
    """A time in a form of ``parse_time``, or a span from now: ``2h``, ``1d12h``. Raises BadInput."""
    ahead = _RELATIVE.fullmatch(f"-{text.strip()}")
    return 2 * now_ns - parse_time(f"-{text.strip()}", now_ns) if ahead else parse_time(text, now_ns)


def parse_due(text: str, now_ns: int) -> int:
    """A due date in a form of ``parse_until``; it must be in the future. 0 for an empty text. Raises
    BadInput."""
    found = parse_until(text, now_ns) if text.strip() else 0
    if text.strip() and found <= now_ns:
        raise BadInput(f"The due time {text!r} has passed.", remedy="Give a time in the future, or none.")
    return found


def parse_moment(text: str, now_ns: int) -> Moment:
    """A whole number is a position, every other text a time. Raises BadInput."""
    if text.strip().isdigit():
        return Moment(position=int(text))
    return Moment(at_ns=parse_time(text, now_ns))


def show_time(ns: int, zone: tzinfo | None = None) -> str:
    """For people: local time to the millisecond with its offset, in the form that every command writes:
    ``2026-05-04 10:30:00.250+02:00``; empty for 0. ``parse_time`` reads it."""
    if not ns:
        return ""
    local = _to_datetime(ns, zone).replace(microsecond=ns // 1_000_000 % 1000 * 1000)
    return local.isoformat(" ", "milliseconds")


def iso_time(ns: int) -> str:
    """UTC with nanoseconds, for programs; ``parse_time`` gives the same number back."""
    return f"{_to_datetime(ns, UTC):%Y-%m-%dT%H:%M:%S}.{ns % 1_000_000_000:09d}Z"


_MOMENTS = ("at", "since", "until")
_FOREIGN = ("result", "value", "variables", "facts")
"""Fields whose content has no known format."""


def with_iso_times(plain: Any) -> Any:
    """Plain data for programs: nanoseconds in fields that hold times (``…_at``, ``since``, ``until``, pairs
    in ``busy``) become the text of ``iso_time``, empty for 0."""
    if isinstance(plain, list | tuple):
        return [with_iso_times(item) for item in plain]
    if not isinstance(plain, dict):
        return plain
    return {name: _show_moments(name, value) for name, value in plain.items()}


def _show_moments(name: str, value: Any) -> Any:
    if name in _FOREIGN:
        return value
    if name == "busy" and isinstance(value, list | tuple):
        return [[iso_time(ns) for ns in span] for span in value]
    if type(value) is int and (name in _MOMENTS or name.endswith("_at")):
        return iso_time(value) if value else ""
    return with_iso_times(value)


def _to_datetime(ns: int, zone: tzinfo | None) -> datetime:
    return (_EPOCH + timedelta(seconds=ns // 1_000_000_000)).astimezone(zone)


def show_span(seconds: float) -> str:
    """``0.25 s``, ``42 s``, ``3 min 05 s``, ``2 h 14 min``, ``3 d 04 h``."""
    if seconds < 10:
        return f"{seconds:.2f}".rstrip("0").rstrip(".") + " s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    minutes = round(seconds / 60)
    if minutes < 24 * 60:
        return f"{minutes // 60} h {minutes % 60:02d} min"
    hours = round(seconds / 3600)
    return f"{hours // 24} d {hours % 24:02d} h"
