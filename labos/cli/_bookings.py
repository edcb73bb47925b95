"""Bookings in words, in a table, and as a week of 80 columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, time, timedelta
from typing import Any

from labos.cli._out import show_table
from labos.cli._when import to_ns
from labos.core.ids import local
from labos.core.recurrence import in_zone

WIDTH = 80
BAR = 24
"""Columns of a day: one for each hour."""
NAME = 17
DAY = 11
HOURS = "0     6     12    18    "


def describe_owner(booking: Mapping[str, Any]) -> str:
    """For whom the booking is."""
    if booking["maintenance"]:
        return "maintenance"
    return f"group {booking['group']}" if booking["group"] else str(booking["user"])


def describe_booking(booking: Mapping[str, Any]) -> str:
    """``rpl/hidex for group chemistry from 2026-11-26 09:00 CET until 12:00, FREQ=WEEKLY``"""
    zone = booking["zone"]
    begins, ends = in_zone(booking["begins_at"], zone), in_zone(booking["ends_at"], zone)
    again = f", {booking['rule']}" if booking["rule"] else ""
    return f"{booking['target']} is booked for {describe_owner(booking)} from {begins} until {ends}{again}"


def show_bookings(bookings: Sequence[Mapping[str, Any]]) -> None:
    """A table with the next time of each booking."""
    rows = [
        (
            str(booking["id"]),
            local(booking["target"]),
            describe_owner(booking),
            in_zone(booking["next_begins_at"] or booking["begins_at"], booking["zone"]),
            in_zone(booking["next_ends_at"] or booking["ends_at"], booking["zone"]),
            "now" if booking["now"] else "",
            str(booking["rule"]),
            str(booking["by"]),
            str(booking["why"]),
        )
        for booking in bookings
    ]
    show_table(("id", "target", "for", "from", "until", "", "again", "by", "why"), rows)


def list_week(times: Sequence[Mapping[str, Any]], first_day: datetime, days: int, zone: str) -> Iterator[str]:
    """Each day, and each time that is booked on it: a bar of its hours (``#``, ``m`` for maintenance), then
    its times and for whom it is. No line is wider than 80 columns."""
    yield f"{f'{first_day:%G week %V}, {zone}'[: DAY + NAME - 1]:<{DAY + NAME}}{HOURS}".rstrip()
    for number in range(days):
        day = first_day + timedelta(days=number)
        begin, end = (to_ns(date.date(), time(), zone) for date in (day, day + timedelta(days=1)))
        name = f"{day:%a %d %b}"
        here = [one for one in times if one["begins_at"] < end and one["ends_at"] > begin]
        if not here:
            yield f"{name:<{DAY}}-"
        for one in here:
            yield _line(name, one, begin, end, zone)[:WIDTH].rstrip()
            name = ""


def _line(name: str, time: Mapping[str, Any], begin: int, end: int, zone: str) -> str:
    since, until = max(begin, time["begins_at"]), min(end, time["ends_at"])
    clock = f"{_show_clock(since, zone)}-{'24:00' if until == end else _show_clock(until, zone)}"
    target = local(time["target"])
    target = target if len(target) < NAME else f"{target[: NAME - 2]}…"
    bar = _draw_bar(time, begin, end)
    return f"{name:<{DAY}}{target:<{NAME}}{bar} {clock} {time['booking']} {describe_owner(time)}"


def _draw_bar(time: Mapping[str, Any], begin: int, end: int) -> str:
    hour = (end - begin) / BAR
    mark = "m" if time["maintenance"] else "#"
    spans = ((begin + n * hour, begin + (n + 1) * hour) for n in range(BAR))
    return "".join(mark if a < time["ends_at"] and b > time["begins_at"] else "." for a, b in spans)


def _show_clock(at: int, zone: str) -> str:
    return in_zone(at, zone)[11:16]
