"""The times of a repeated booking: a rule of iCalendar (RFC 5545), by the local time of a time zone.

A weekly 09:00 stays 09:00 local time when clocks are changed; durations are in real time. The result depends
on the time zone data of this computer. So it is computed when it is needed, and is not part of any state.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from calendar import monthrange
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime, tzinfo
from functools import lru_cache
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from dateutil.rrule import rrule, rrulestr

SECOND_NS = 1_000_000_000
DAY_NS = 86_400 * SECOND_NS

WEEK = ("MO", "TU", "WE", "TH", "FR", "SA", "SU")
_DAY = rf"([+-]?[1-5])?({'|'.join(WEEK)})"
FREQUENCIES = ("DAILY", "WEEKLY", "MONTHLY", "YEARLY")
PARTS = ("FREQ", "INTERVAL", "BYDAY", "BYMONTHDAY", "BYMONTH", "BYSETPOS", "WKST", "COUNT")
"""The allowed parts of a rule. The end of the rule is given separately; hours and minutes are those of the
first time."""

LONGEST_RULE = 200
MOST_TIMES = 20_000
"""A rule is over after this number of times: more than 50 years of days."""

LATEST = 4_102_444_800 * SECOND_NS
"""Times are computed up to the year 2100."""


def find_zone(name: str) -> tzinfo:
    """The time zone with this name. Raises ValueError if there is none."""
    if name in ("", "UTC"):
        return UTC
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise ValueError(f"{name!r} is not a time zone") from None


def zone_or_utc(name: str) -> tzinfo:
    """The time zone with this name, or UTC if this computer does not know it."""
    try:
        return find_zone(name)
    except ValueError:
        return UTC


def in_zone(at: int, zone: str) -> str:
    """A time (UTC ns) as local time: ``2026-11-26 09:00 CET``. By UTC if this computer does not know the
    zone."""
    return datetime.fromtimestamp(at // SECOND_NS, zone_or_utc(zone)).strftime("%Y-%m-%d %H:%M %Z")


def find_rule_fault(rule: str, zone: str, first: int) -> str:
    """The fault of a rule whose first time is ``first`` (UTC ns), as a sentence; empty if there is none."""
    if len(rule) > LONGEST_RULE:
        return f"A rule has at most {LONGEST_RULE} characters."
    parts = _split_rule(rule)
    for part in parts:
        if part not in PARTS:
            return f"A rule may contain {', '.join(PARTS)}, not {part!r}."
    if parts.get("FREQ") not in FREQUENCIES:
        return f"A rule begins with FREQ= and one of {', '.join(FREQUENCIES)}."
    if "BYSETPOS" in parts and (
        parts["FREQ"] in FREQUENCIES[:2] or not re.fullmatch(r"-?[1-5]", parts["BYSETPOS"])
    ):
        return "BYSETPOS is a number from -5 to 5, and of months or years."
    if not re.fullmatch(f"{_DAY}(,{_DAY})*", parts.get("BYDAY", "MO")):
        return "BYDAY names days like MO or TH, or of months and years also like 1MO (the first) or -1FR."
    for part in ("INTERVAL", "COUNT"):
        if not re.fullmatch(r"[1-9]\d{0,4}", parts.get(part, "1")):
            return f"{part} is a number from 1 to 99999."
    try:
        local = _convert_to_local(first, find_zone(zone))
        found = _read(parts, local, local)
        # A rule that never matches would be searched until the year 9999.
        begins = next(iter(found), None) if _may_be_on(parts, local) else None
    except (ValueError, TypeError, OverflowError) as error:
        return f"{rule!r} is not a rule of iCalendar ({str(error).rstrip('.')})."
    return "" if begins == local else "The first time does not follow the rule."


def list_times_between(rule: str, zone: str, first: int, after: int, before: int) -> list[int]:
    """The times of a rule from ``after`` (inclusive) to ``before`` (exclusive), in UTC ns. ``first`` can be
    among them."""
    found = _find_times(rule, zone, first).list_until(min(before, LATEST))
    return found[bisect_left(found, after) : bisect_left(found, before)]


def _split_rule(rule: str) -> dict[str, str]:
    return dict(part.partition("=")[::2] for part in rule.split(";"))


def _may_be_on(parts: Mapping[str, str], day: datetime) -> bool:
    """Whether a day matches the months, days of the month and days of the week of a rule."""
    last = monthrange(day.year, day.month)[1]
    days = {str(day.day), f"+{day.day}", str(day.day - last - 1)}
    week = {part[-2:] for part in parts.get("BYDAY", "").split(",")}
    return (
        str(day.month) in parts.get("BYMONTH", str(day.month)).split(",")
        and bool(days & set(parts.get("BYMONTHDAY", str(day.day)).split(",")))
        and ("BYDAY" not in parts or WEEK[day.weekday()] in week)
    )


def _convert_to_local(at: int, zone: tzinfo) -> datetime:
    """A time (UTC ns) as local time."""
    return datetime.fromtimestamp(at // SECOND_NS, zone).replace(tzinfo=None)


def _read(parts: Mapping[str, str], first: datetime, last: datetime) -> rrule:
    """Parse a rule, with an end at ``last``. ``COUNT`` is left out here and applied elsewhere: a rule that
    never matches would not end."""
    texts = [f"{part}={value}" for part, value in parts.items() if part != "COUNT"]
    found = rrulestr(";".join([*texts, f"UNTIL={last:%Y%m%dT%H%M%S}"]), dtstart=first, ignoretz=True)
    if not isinstance(found, rrule):
        raise ValueError("it is more than one rule")
    return found


class _Times:
    """The times of a rule, computed as far as they were needed."""

    def __init__(self, rule: str, zone: str, first: int) -> None:
        self._zone, self._rest = find_zone(zone), first % SECOND_NS
        parts = _split_rule(rule)
        self._most = min(int(parts.get("COUNT", MOST_TIMES)), MOST_TIMES)
        end = _convert_to_local(LATEST, self._zone)
        self._more: Iterator[datetime] = iter(_read(parts, _convert_to_local(first, self._zone), end))
        self._known: list[int] = []
        self._over = False

    def list_until(self, time: int) -> list[int]:
        while not self._over and (not self._known or self._known[-1] < time):
            local = next(self._more, None)
            if local is None or len(self._known) >= self._most:
                self._over = True
                break
            at = int(local.replace(tzinfo=self._zone).timestamp()) * SECOND_NS + self._rest
            self._known.append(at)
        return self._known


@lru_cache(maxsize=1024)
def _find_times(rule: str, zone: str, first: int) -> _Times:
    return _Times(rule, zone, first)
