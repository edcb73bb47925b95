"""Times in the forms that people use for bookings: ``tomorrow 09:00``, ``mon 9:00``, ``+2h``."""

from __future__ import annotations

import os
import re
from datetime import UTC, date, datetime, time, timedelta
from pathlib import Path

from labos.core.recurrence import SECOND_NS, find_zone
from labos.errors import BadInput
from labos.services.times import parse_time, parse_until

DAYS = ("monday", "tuesday", "wednesday", "thursday", "friday", "saturday", "sunday")
EXAMPLES = "Write '2026-11-26 09:00', 'tomorrow 09:00', 'mon 09:00', 09:00, +2h or now."

_CLOCK = re.compile(r"(\d{1,2}):(\d\d)")
_LENGTH = re.compile(r"\+((?:\d+(?:\.\d+)?\s*(?:d|h|min|m|s)\s*)+)")

EVERY = {
    "day": "FREQ=DAILY",
    "week": "FREQ=WEEKLY",
    "weekday": "FREQ=WEEKLY;BYDAY=MO,TU,WE,TH,FR",
    "month": "FREQ=MONTHLY",
    "year": "FREQ=YEARLY",
}
_EVERY_SO_MANY = re.compile(r"(\d{1,3}) (day|week|month|year)s?")


def find_local_zone() -> str:
    """The name of this computer's time zone; UTC if it cannot be found."""
    named = os.environ.get("TZ", "").lstrip(":")
    if not named:
        try:
            named = str(Path("/etc/localtime").resolve()).partition("zoneinfo/")[2]
        except OSError:
            named = ""
    try:
        find_zone(named)
    except ValueError:
        return "UTC"
    return named or "UTC"


def expect_zone(name: str | None) -> str:
    """The time zone of that name; this computer's if no name is given. Raises BadInput."""
    if name is None:
        return find_local_zone()
    try:
        find_zone(name)
    except ValueError:
        raise BadInput(
            f"{name!r} is not a time zone.", remedy="Write one like Europe/Zurich, or UTC."
        ) from None
    return name


def parse_when(text: str, now: int, zone: str, *, after: int = 0) -> int:
    """A time (UTC ns) in a time zone. A duration (``+2h``) counts from ``after``, else from now; a time
    without a day is the next one after that. Raises BadInput."""
    words = text.strip().lower()
    length = _LENGTH.fullmatch(words)
    if length:
        return parse_until(length[1], after or now)
    where = find_zone(zone)
    day, _, clock = words.rpartition(" ")
    at = _parse_clock(clock)
    today = datetime.fromtimestamp((after or now) // SECOND_NS, where)
    if at is not None and not day:
        found = to_ns(today.date(), at, zone)
        return found if found > (after or now) else to_ns(today.date() + timedelta(days=1), at, zone)
    named = _parse_day(day or words, datetime.fromtimestamp(now // SECOND_NS, where).date())
    if named is not None and (at is not None or not day):
        return to_ns(named, at or time(), zone)
    try:
        return parse_time(text, now, where)
    except BadInput as error:
        raise BadInput(error.message, remedy=EXAMPLES) from None


def _parse_clock(text: str) -> time | None:
    found = _CLOCK.fullmatch(text)
    if found is None or int(found[1]) > 23 or int(found[2]) > 59:
        return None
    return time(int(found[1]), int(found[2]))


def _parse_day(text: str, today: date) -> date | None:
    """Today, tomorrow, or the next day of that name."""
    if text in ("today", "tomorrow"):
        return today + timedelta(days=text == "tomorrow")
    meant = [number for number, name in enumerate(DAYS) if len(text) >= 3 and name.startswith(text)]
    return today + timedelta(days=(meant[0] - today.weekday() - 1) % 7 + 1) if meant else None


def to_ns(day: date, clock: time, zone: str) -> int:
    """The time (UTC ns) of a day and a clock in a time zone."""
    local = datetime.combine(day, clock, find_zone(zone))
    return int(local.astimezone(UTC).timestamp()) * SECOND_NS


def rule_of(every: str | None, rule: str | None) -> str:
    """The rule that follows from ``--every`` or ``--rule``; empty if neither is given. Raises BadInput."""
    if rule is not None:
        if every is not None:
            raise BadInput("--every and --rule cannot be combined.", remedy="Leave one of them out.")
        return rule.upper().removeprefix("RRULE:")
    if every is None:
        return ""
    words = every.strip().lower()
    so_many = _EVERY_SO_MANY.fullmatch(words)
    if so_many:
        return f"{EVERY[so_many[2]]};INTERVAL={int(so_many[1])}"
    if words not in EVERY:
        raise BadInput(
            f"{every!r} is not a valid repetition.",
            remedy="Write day, week, weekday, month, year or '2 weeks'. Use --rule for other repetitions.",
        )
    return EVERY[words]
