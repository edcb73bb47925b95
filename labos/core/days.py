"""Days in the form that packs and certificates use: ``2027-05-31``, by UTC."""

from __future__ import annotations

from datetime import UTC, date, datetime


def day_of(now: int) -> str:
    """The day (UTC) of a time in UTC ns."""
    return datetime.fromtimestamp(now // 10**9, UTC).date().isoformat()


def is_day(text: str) -> bool:
    """Whether a text is a valid date."""
    try:
        return date.fromisoformat(text).isoformat() == text
    except ValueError:
        return False


def end_of(day: str) -> int:
    """The end of a day, in seconds since 1970."""
    return int(datetime.fromisoformat(day).replace(tzinfo=UTC).timestamp()) + 86_400


def count_days(first: str, last: str) -> int:
    """The number of days from the first day to the last one; negative if the last one is earlier."""
    return (date.fromisoformat(last) - date.fromisoformat(first)).days
