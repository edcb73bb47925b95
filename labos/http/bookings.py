"""Bookings and the calendar, as the types of requests and answers."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec

from labos.core.bookings import Booking, BookingSpan
from labos.core.decide.bookings import NewTerms
from labos.core.ids import split_key
from labos.core.recurrence import DAY_NS
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.users import find_person
from labos.errors import BadInput, NotFound
from labos.http.bodies import By
from labos.http.limits import Line, Name, Time, says
from labos.http.service import LabService

LONGEST_CALENDAR_DAYS = 400
MOST_TIMES = 5_000
"""The largest number of times in one calendar."""

BEGINS = "when it begins (UTC nanoseconds)"
ENDS = "when it ends (UTC nanoseconds)"
WHOM = "the group or user for whom it is booked; `group:NAME` or `user:ID` if both have this name"
NOBODY = "a booking for maintenance, during which no run uses it"
WHY = "what for"
ZONE = "the time zone in which the booking is shown and repeated, such as `Europe/Zurich`"
RULE = "how it repeats, as in iCalendar: `FREQ=WEEKLY;BYDAY=MO,TH`; empty: once"
LAST = "the latest beginning of a repeated booking (UTC nanoseconds); 0: without end"
Force = Annotated[bool, says("override bookings of others; only for admins")]


class NewBooking(By, forbid_unknown_fields=True, kw_only=True):
    """A booking of a module or a workcell for one user or group."""

    target: Annotated[Name, says("a module or a workcell")]
    begins_at: Annotated[Time, says(BEGINS)]
    ends_at: Annotated[Time, says(ENDS)]
    whom: Annotated[Name, says(WHOM + "; left out: the user who asks")] = ""
    maintenance: Annotated[bool, says(NOBODY)] = False
    why: Annotated[Line, says(WHY)] = ""
    zone: Annotated[Name, says(ZONE)] = "UTC"
    rule: Annotated[Name, says(RULE)] = ""
    last_at: Annotated[Time, says(LAST)] = 0
    force: Force = False


class BookingChange(By, forbid_unknown_fields=True, kw_only=True):
    """Fields that are left out do not change."""

    begins_at: Annotated[
        Time | None, says(BEGINS + "; if no end is given, the end moves by the same time")
    ] = None
    ends_at: Annotated[Time | None, says(ENDS)] = None
    whom: Annotated[Name | None, says(WHOM)] = None
    maintenance: Annotated[bool | None, says(NOBODY)] = None
    why: Annotated[Line | None, says(WHY)] = None
    zone: Annotated[Name | None, says(ZONE)] = None
    rule: Annotated[Name | None, says(RULE)] = None
    last_at: Annotated[Time | None, says(LAST)] = None
    force: Force = False


class BookingCancel(By, forbid_unknown_fields=True, kw_only=True):
    begins_at: Annotated[
        Time, says("for a repeated booking: cancel only the time that begins then (UTC nanoseconds)")
    ] = 0
    why: Annotated[Line, says("the reason")] = ""


class OfBooking(msgspec.Struct, frozen=True):
    booking: Annotated[Name, says("a booking's id", "B3")]


class BookingsQuery(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    target: Annotated[
        Name, says("only those of this workcell, or of this module (including those of its workcell)")
    ] = ""


class CalendarQuery(BookingsQuery, frozen=True, forbid_unknown_fields=True):
    since: Annotated[Time, says("the beginning of the period (UTC nanoseconds); 0: now")] = 0
    until: Annotated[Time, says("the end of the period (UTC nanoseconds); 0: a week")] = 0


class LinkQuery(BookingsQuery, frozen=True, forbid_unknown_fields=True):
    token: Annotated[
        Name, says("a token of scope `viewer`, for calendar programs that cannot send it in a header")
    ] = ""


class BookingView(msgspec.Struct, frozen=True):
    """The first time of the booking, and its present or next time (``next_…``, 0: none), in UTC nanoseconds.
    ``now``: it is under way. ``skipped_at`` are the beginnings of times that are left out. ``over`` are the
    bookings that it has overridden."""

    id: str
    target: str
    begins_at: int
    ends_at: int
    user: str
    group: str
    maintenance: bool
    why: str
    zone: str
    rule: str
    last_at: int
    by: str
    now: bool
    next_begins_at: int
    next_ends_at: int
    skipped_at: tuple[int, ...] = ()
    over: tuple[str, ...] = ()


class BookingList(msgspec.Struct, frozen=True):
    bookings: list[BookingView]


class BookedTime(msgspec.Struct, frozen=True):
    """One time of a booking (UTC nanoseconds)."""

    booking: str
    target: str
    begins_at: int
    ends_at: int
    user: str
    group: str
    maintenance: bool
    why: str
    now: bool


class CalendarView(msgspec.Struct, frozen=True):
    """The booked times between ``since`` and ``until``, in order."""

    since: int
    until: int
    times: list[BookedTime]


class BookingCancelled(msgspec.Struct, frozen=True):
    """``begins_at`` is the beginning of the cancelled time; 0: the whole booking."""

    booking: str
    begins_at: int


def make_view(booking: Booking, over: tuple[str, ...] = ()) -> BookingView:
    span = (
        BookingSpan(booking.began, booking.until, booking.id)
        if booking.began
        else booking.find_next_span(booking.handled)
    )
    return make_from(
        BookingView,
        booking,
        begins_at=booking.begins,
        ends_at=booking.ends,
        last_at=booking.last,
        now=bool(booking.began),
        next_begins_at=span.begins if span is not None else 0,
        next_ends_at=span.ends if span is not None else 0,
        skipped_at=booking.skipped,
        over=over,
    )


def find_booking(state: LabState, name: str) -> Booking:
    """Raises NotFound."""
    found = state.bookings.open.get(name)
    if found is None:
        raise NotFound(f"There is no current or future booking {name!r}.", remedy="List them: labos bookings")
    return found


def select_bookings(service: LabService, target: str) -> list[Booking]:
    """The bookings of a module or a workcell, or all, in the order in which they were made. Raises
    NotFound."""
    state = service.kernel.state
    if not target:
        return list(state.bookings.open.values())
    if target in state.lab.workcells:
        return state.bookings.list_in_cell(target)
    return state.bookings.list_for(service.module(target))


def make_calendar(service: LabService, query: CalendarQuery, now: int) -> CalendarView:
    """Raises NotFound, BadInput."""
    since = query.since or now
    until = query.until or since + 7 * DAY_NS
    if not since < until <= since + LONGEST_CALENDAR_DAYS * DAY_NS:
        raise BadInput(
            f"A calendar shows 1 to {LONGEST_CALENDAR_DAYS} days.", remedy="Ask for a shorter period."
        )
    found: list[tuple[BookingSpan, Booking]] = []
    for booking in select_bookings(service, query.target):
        found += [(span, booking) for span in booking.list_spans(since, until)]
    found.sort(key=lambda pair: (pair[0].begins, pair[0].ends, pair[1].id))
    if len(found) > MOST_TIMES:
        raise BadInput(
            f"The calendar would have more than {MOST_TIMES} times.", remedy="Ask for a shorter period."
        )
    times = [
        make_from(
            BookedTime,
            booking,
            booking=booking.id,
            begins_at=span.begins,
            ends_at=span.ends,
            now=booking.began == span.begins,
        )
        for span, booking in found
    ]
    return CalendarView(since, until, times)


def find_target(service: LabService, name: str) -> str:
    """A module or a workcell by its name. Raises NotFound."""
    return name if name in service.kernel.state.lab.workcells else service.module(name)


def make_terms(state: LabState, body: NewBooking) -> NewTerms:
    user, group = _find_owner(state, body.whom, body.by)
    if body.maintenance and body.whom:
        raise BadInput(
            "A booking for maintenance cannot be for a group or a user.",
            remedy="Leave out the group or user.",
        )
    if body.maintenance:
        user = group = ""
    return make_from(
        NewTerms,
        body,
        begins=body.begins_at,
        ends=body.ends_at,
        user=user,
        group=group,
        last=body.last_at,
    )


def change_terms(state: LabState, booking: Booking, body: BookingChange) -> NewTerms:
    """The terms of a booking after a change. If only its beginning is changed, its end moves by the same
    time."""
    user, group, maintenance = booking.user, booking.group, booking.maintenance
    if body.maintenance is not None:
        maintenance = body.maintenance
        user, group = ("", "") if maintenance else _find_owner(state, "", body.by)
    if body.whom is not None:
        user, group = _find_owner(state, body.whom, body.by)
        maintenance = False
    begins, ends = body.begins_at, body.ends_at
    if begins is not None and ends is None:
        ends = begins + booking.ends - booking.begins
    times = {"begins": begins, "ends": ends, "zone": body.zone, "rule": body.rule, "last": body.last_at}
    given: dict[str, Any] = {name: value for name, value in times.items() if value is not None}
    owner = {"user": user, "group": group, "maintenance": maintenance}
    terms = make_from(NewTerms, booking, why=body.why, **owner, **given)
    return terms if terms.rule else msgspec.structs.replace(terms, last=0)


def _find_owner(state: LabState, owner: str, by: str) -> tuple[str, str]:
    """The user or the group that the request names; the requesting user if it names none. Raises BadInput."""
    kind, name = split_key(owner)
    if not owner:
        return find_person(by), ""
    if name and kind in ("user", "group"):
        return (name, "") if kind == "user" else ("", name)
    if owner in state.shares.groups:
        if owner in state.users.known:
            raise BadInput(
                f"{owner!r} is the name of a group and of a user.",
                remedy=f"Write group:{owner} or user:{owner}.",
            )
        return "", owner
    return owner, ""
