"""Days as packs and certificates bear them: ``2027-05-31``, by UTC."""

from __future__ import annotations

from datetime import UTC, date, datetime


def day_of(now: int) -> str:
    """The day (UTC) of a moment in UTC ns."""
    return datetime.fromtimestamp(now // 10**9, UTC).date().isoformat()


def is_day(text: str) -> bool:
    """Whether a text is a day of the calendar."""
    try:
        return date.fromisoformat(text).isoformat() == text
    except ValueError:
        return False


def end_of(day: str) -> int:
    """When a day is over, in seconds since 1970."""
    return int(datetime.fromisoformat(day).replace(tzinfo=UTC).timestamp()) + 86_400


def count_days(first: str, last: str) -> int:
    """How many days the last one is after the first one; below 0 if it is before."""
    return (date.fromisoformat(last) - date.fromisoformat(first)).days
