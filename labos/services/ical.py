"""Bookings as iCalendar (RFC 5545), for calendar programs."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta

from icalendar import Calendar, Event, vRecur

from labos.core.bookings import Booking
from labos.core.ids import local
from labos.core.recurrence import zone_or_utc
from labos.core.state import LabState

YEARS = 30
"""A time zone is described for so many years after the latest booking."""


def encode_ical(state: LabState, bookings: Sequence[Booking]) -> bytes:
    """A calendar of these bookings. As long as they do not change, its bytes do not change."""
    calendar = Calendar()
    calendar.add("prodid", "-//LabOS//bookings//EN")
    calendar.add("version", "2.0")
    calendar.add("method", "PUBLISH")
    calendar.add("x-wr-calname", f"LabOS: {state.lab.name}")
    calendar.add("x-published-ttl", "PT15M")
    for booking in bookings:
        calendar.add_component(_make_event(state, booking))
    begins = [booking.begins for booking in bookings]
    calendar.add_missing_timezones(
        _to_datetime(min(begins, default=0), "UTC").date() - timedelta(days=366),
        _to_datetime(max(begins, default=0), "UTC").date() + timedelta(days=366 * YEARS),
    )
    return bytes(calendar.to_ical())


def _make_event(state: LabState, booking: Booking) -> Event:
    event = Event()
    event.add("uid", f"{booking.id}@{state.lab.id}")
    event.add("sequence", booking.made)
    event.add("dtstamp", _to_datetime(booking.made_at, "UTC"))
    event.add("dtstart", _to_datetime(booking.begins, booking.zone))
    event.add("dtend", _to_datetime(booking.ends, booking.zone))
    event.add("summary", f"{local(booking.target)}: {booking.whom}")
    event.add("location", booking.target)
    why = f": {booking.why}" if booking.why else ""
    event.add("description", f"{booking.id}, booked by {booking.by}{why}")
    event.add("categories", ["maintenance" if booking.maintenance else "booking"])
    if booking.rule:
        rule = vRecur.from_ical(booking.rule)
        if booking.last and "COUNT" not in rule:
            rule["UNTIL"] = [_to_datetime(booking.last, "UTC")]
        event.add("rrule", rule)
        for begins in booking.skipped:
            event.add("exdate", _to_datetime(begins, booking.zone))
    return event


def _to_datetime(at: int, zone: str) -> datetime:
    return datetime.fromtimestamp(at // 1_000_000_000, zone_or_utc(zone))
