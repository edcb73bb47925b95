"""Bookings: which user or group may use a module or a workcell, and when."""

from __future__ import annotations

import asyncio
from typing import Annotated, Any

import msgspec
from starlette.responses import Response

from labos.core.bookings import Booking, BookingSpan
from labos.core.decide.bookings import CancelBooking, ChangeBooking, MakeBooking, NewTerms
from labos.core.ids import split_key
from labos.core.recurrence import DAY_NS
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.users import find_person
from labos.core.words import list_references, put_into_text
from labos.errors import BadInput, NotFound
from labos.http.bodies import By
from labos.http.limits import Line, Name, Time, says
from labos.http.operation import Call, Method, change, read
from labos.http.service import LabService
from labos.services.shown import read_texts

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


class NewBooking(By, kw_only=True):
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


class BookingChange(By, kw_only=True):
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


class BookingCancel(By, kw_only=True):
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


class CalendarQuery(BookingsQuery, frozen=True):
    since: Annotated[Time, says("the beginning of the period (UTC nanoseconds); 0: now")] = 0
    until: Annotated[Time, says("the end of the period (UTC nanoseconds); 0: a week")] = 0


class LinkQuery(BookingsQuery, frozen=True):
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


MEDIA_TYPE = "text/calendar"

_AT = 1_764_144_000_000_000_000
_BOOKING = {
    "id": "B3",
    "target": "rpl/ot2_pcr_alpha",
    "begins_at": _AT,
    "ends_at": _AT + 7_200_000_000_000,
    "user": "",
    "group": "chemistry",
    "maintenance": False,
    "why": "course",
    "zone": "Europe/Zurich",
    "rule": "FREQ=WEEKLY",
    "last_at": 0,
    "by": "ada",
    "now": False,
    "next_begins_at": _AT,
    "next_ends_at": _AT + 7_200_000_000_000,
    "skipped_at": [],
    "over": [],
}
_TIME = {name: _BOOKING[name] for name in ("target", "begins_at", "ends_at", "user", "group", "why", "now")}


@read(
    route="GET /bookings",
    client=Method("bookings", "target", take="bookings"),
    summary="List the bookings",
    problems=("not_found",),
    example_answer={"bookings": [_BOOKING]},
)
def list_bookings(call: Call, query: BookingsQuery) -> BookingList:
    """The bookings that have not ended, in the order of their next times."""
    views = [_make_view(booking) for booking in _select_bookings(call.service, query.target)]
    return BookingList(sorted(views, key=lambda one: (one.next_begins_at, one.begins_at, one.id)))


@change(
    route="POST /bookings",
    client=Method("book", "target, begins_at, ends_at, by", key="new"),
    summary="Book a module or a workcell",
    status=201,
    problems=("refused", "not_found"),
    example={
        "target": "ot2_pcr_alpha",
        "begins_at": _AT,
        "ends_at": _AT + 7_200_000_000_000,
        "whom": "chemistry",
        "why": "course",
        "zone": "Europe/Zurich",
        "rule": "FREQ=WEEKLY",
        "by": "ada",
    },
    example_answer=_BOOKING,
)
async def make_booking(call: Call, body: NewBooking) -> BookingView:
    """Runs of other users start nothing that would still be there at that time. If another user or group has
    a booking at that time, the request is refused, unless an admin forces it. A booking for maintenance
    cannot be overridden."""
    state, now = call.kernel.state, call.kernel.clock.now_ns()
    target = body.target if body.target in state.lab.workcells else call.service.module(body.target)
    terms = _make_terms(state, body)
    events = await call.kernel.execute(MakeBooking(target, terms, body.by, now, body.force), body.by)
    return _make_view(_find_booking(call.kernel.state, events[0].booking), events[0].over)  # type: ignore[attr-defined]


@read(
    route="GET /bookings/{booking}",
    client=Method("booking"),
    summary="A booking",
    example_answer=_BOOKING,
)
def get_booking(call: Call, path: OfBooking) -> BookingView:
    return _make_view(_find_booking(call.kernel.state, path.booking))


@change(
    route="POST /bookings/{booking}/change",
    client=Method("change_booking", repeat=True),
    summary="Change the time or the owner of a booking",
    example={"begins_at": _AT, "ends_at": _AT + 7_200_000_000_000, "by": "ada"},
    example_answer=_BOOKING,
)
async def change_booking(call: Call, path: OfBooking, body: BookingChange) -> BookingView:
    """Fields that are left out do not change. If only the beginning is given, the end moves by the same
    time."""
    booking, now = _find_booking(call.kernel.state, path.booking), call.kernel.clock.now_ns()
    terms = _change_terms(call.kernel.state, booking, body)
    events = await call.kernel.execute(ChangeBooking(booking.id, terms, body.by, now, body.force), body.by)
    return _make_view(_find_booking(call.kernel.state, booking.id), events[0].over)  # type: ignore[attr-defined]


@change(
    route="POST /bookings/{booking}/cancel",
    client=Method("cancel_booking", take=None, key="new"),
    summary="Cancel a booking, or one time of it",
    example={"by": "ada", "why": "not needed"},
    example_answer={"booking": "B3", "begins_at": 0},
)
async def cancel_booking(call: Call, path: OfBooking, body: BookingCancel) -> BookingCancelled:
    """Everybody may then use that time, also if it has begun."""
    _find_booking(call.kernel.state, path.booking)
    await call.kernel.execute(CancelBooking(path.booking, body.by, body.why, body.begins_at), body.by)
    return BookingCancelled(path.booking, body.begins_at)


@read(
    route="GET /calendar",
    client=Method("calendar", "since, until, target"),
    summary="List the booked times",
    problems=("not_found",),
    example_answer={
        "since": _AT,
        "until": _AT + 7 * DAY_NS,
        "times": [{"booking": "B3", "maintenance": False, **_TIME}],
    },
)
def show_calendar(call: Call, query: CalendarQuery) -> CalendarView:
    """Each time of each booking, also of repeated ones."""
    since = query.since or call.kernel.clock.now_ns()
    until = query.until or since + 7 * DAY_NS
    if not since < until <= since + LONGEST_CALENDAR_DAYS * DAY_NS:
        raise BadInput(
            f"A calendar shows 1 to {LONGEST_CALENDAR_DAYS} days.", remedy="Ask for a shorter period."
        )
    found: list[tuple[BookingSpan, Booking]] = []
    for booking in _select_bookings(call.service, query.target):
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


@read(
    route="GET /calendar.ics",
    client=Method("calendar_file", "target", without=("token",)),
    answer=bytes,
    media=(MEDIA_TYPE,),
    summary="The calendar for calendar programs",
    by_link=True,
    problems=("not_found",),
)
async def export_calendar(call: Call, query: LinkQuery) -> Response:
    """All bookings as iCalendar (RFC 5545). A calendar program subscribes to it with a token of scope
    `viewer` in the address."""
    from labos.services.ical import encode_ical  # a large library, which few labs need

    bookings = _select_bookings(call.service, query.target)
    await call.kernel.flush()
    named = list_references("\n".join(booking.why for booking in bookings).encode())
    texts = await asyncio.to_thread(read_texts, call.service.parts.store, named)
    shown = [msgspec.structs.replace(each, why=put_into_text(each.why, texts)) for each in bookings]
    found = encode_ical(call.kernel.state, shown)
    headers = {"cache-control": "private, max-age=300"}
    return Response(found, media_type=MEDIA_TYPE, headers=headers)


def _make_view(booking: Booking, over: tuple[str, ...] = ()) -> BookingView:
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


def _find_booking(state: LabState, name: str) -> Booking:
    """Raises NotFound."""
    found = state.bookings.open.get(name)
    if found is None:
        raise NotFound(f"There is no current or future booking {name!r}.", remedy="List them: labos bookings")
    return found


def _select_bookings(service: LabService, target: str) -> list[Booking]:
    """The bookings of a module or a workcell, or all, in the order in which they were made. Raises
    NotFound."""
    state = service.kernel.state
    if not target:
        return list(state.bookings.open.values())
    if target in state.lab.workcells:
        return state.bookings.list_in_cell(target)
    return state.bookings.list_for(service.module(target))


def _make_terms(state: LabState, body: NewBooking) -> NewTerms:
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


def _change_terms(state: LabState, booking: Booking, body: BookingChange) -> NewTerms:
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
