"""Bookings: which user or group may use a module or a workcell, and when."""

from __future__ import annotations

import asyncio

import msgspec
from starlette.responses import Response

from labos.core.decide.bookings import CancelBooking, ChangeBooking, MakeBooking
from labos.core.recurrence import DAY_NS
from labos.core.words import list_references, put_into_text
from labos.http.bookings import (
    BookingCancel,
    BookingCancelled,
    BookingChange,
    BookingList,
    BookingsQuery,
    BookingView,
    CalendarQuery,
    CalendarView,
    LinkQuery,
    NewBooking,
    OfBooking,
    change_terms,
    find_booking,
    find_target,
    make_calendar,
    make_terms,
    make_view,
    select_bookings,
)
from labos.http.method import Method
from labos.http.operation import Call, Operation, command, list_operations, read
from labos.services.shown import read_texts

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
    views = [make_view(booking) for booking in select_bookings(call.service, query.target)]
    return BookingList(sorted(views, key=lambda one: (one.next_begins_at, one.begins_at, one.id)))


@Operation(
    route="POST /bookings",
    client=Method("book", "target, begins_at, ends_at, by", key="new"),
    summary="Book a module or a workcell",
    needs="submitter",
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
    target, terms = find_target(call.service, body.target), make_terms(state, body)
    events = await call.kernel.execute(MakeBooking(target, terms, body.by, now, body.force), body.by)
    return make_view(find_booking(call.kernel.state, events[0].booking), events[0].over)  # type: ignore[attr-defined]


@read(
    route="GET /bookings/{booking}",
    client=Method("booking"),
    summary="A booking",
    example_answer=_BOOKING,
)
def get_booking(call: Call, path: OfBooking) -> BookingView:
    return make_view(find_booking(call.kernel.state, path.booking))


@command(
    route="POST /bookings/{booking}/change",
    client=Method("change_booking", repeat=True),
    summary="Change the time or the owner of a booking",
    needs="submitter",
    example={"begins_at": _AT, "ends_at": _AT + 7_200_000_000_000, "by": "ada"},
    example_answer=_BOOKING,
)
async def change_booking(call: Call, path: OfBooking, body: BookingChange) -> BookingView:
    """Fields that are left out do not change. If only the beginning is given, the end moves by the same
    time."""
    booking, now = find_booking(call.kernel.state, path.booking), call.kernel.clock.now_ns()
    terms = change_terms(call.kernel.state, booking, body)
    events = await call.kernel.execute(ChangeBooking(booking.id, terms, body.by, now, body.force), body.by)
    return make_view(find_booking(call.kernel.state, booking.id), events[0].over)  # type: ignore[attr-defined]


@command(
    route="POST /bookings/{booking}/cancel",
    client=Method("cancel_booking", take=None, key="new"),
    summary="Cancel a booking, or one time of it",
    needs="submitter",
    example={"by": "ada", "why": "not needed"},
    example_answer={"booking": "B3", "begins_at": 0},
)
async def cancel_booking(call: Call, path: OfBooking, body: BookingCancel) -> BookingCancelled:
    """Everybody may then use that time, also if it has begun."""
    find_booking(call.kernel.state, path.booking)
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
    return make_calendar(call.service, query, call.kernel.clock.now_ns())


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

    bookings = select_bookings(call.service, query.target)
    await call.kernel.flush()
    named = list_references("\n".join(booking.why for booking in bookings).encode())
    texts = await asyncio.to_thread(read_texts, call.service.parts.store, named)
    shown = [msgspec.structs.replace(each, why=put_into_text(each.why, texts)) for each in bookings]
    found = encode_ical(call.kernel.state, shown)
    headers = {"cache-control": "private, max-age=300"}
    return Response(found, media_type=MEDIA_TYPE, headers=headers)


OPERATIONS = list_operations(globals(), "bookings")
