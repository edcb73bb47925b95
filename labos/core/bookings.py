"""Bookings: periods in which a user or group has a module or a workcell exclusively.

A booking is planned time. Its begin and its end are separate events. So their consequences do not depend on
when a program checks the time, or on the time zones of a computer.
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from labos.core.ids import ModuleName, workcell_of
from labos.core.recurrence import DAY_NS, list_times_between
from labos.core.registry import Event, event
from labos.core.structs import make_from
from labos.core.words import Words

LEAD_NS = 30 * 60 * 1_000_000_000
"""Users who have to clear the place are notified this long before a booking begins."""

Change = Literal["", "near", "begin", "end"]
"""The change of a booking that is due."""


class BookingEvent(Event, frozen=True):
    booking: str

    def stream(self) -> str:
        return f"booking:{self.booking}"


class BookingTerms(BookingEvent, frozen=True):
    """A module or a workcell (``target``) is booked from ``begins`` to ``ends`` (UTC ns). The booking is for
    a ``user``, for a ``group``, or for ``maintenance``. With a ``rule`` it is repeated by the clock of the
    time zone ``zone``, at the latest at ``last`` (UTC ns; 0: without end). ``over`` lists the bookings that
    it overrides."""

    target: str
    begins: int
    ends: int
    by: str
    user: str = ""
    group: str = ""
    maintenance: bool = False
    why: Words = ""
    zone: str = "UTC"
    rule: str = ""
    last: int = 0
    over: tuple[str, ...] = ()


@event("booking.made")
class BookingMade(BookingTerms, frozen=True):
    """A user booked a module or a workcell. ``over`` lists the bookings that it overrides."""


@event("booking.changed")
class BookingChanged(BookingTerms, frozen=True):
    """A booking has another time or another owner. The event holds the whole booking."""


@event("booking.cancelled")
class BookingCancelled(BookingEvent, frozen=True):
    """A booking is cancelled. If it repeats, all its future times are cancelled."""

    by: str
    why: Words = ""


@event("booking.skipped")
class BookingSkipped(BookingEvent, frozen=True):
    """One time of a repeated booking is left out. ``begins`` is the beginning of that time (UTC ns)."""

    begins: int
    by: str
    why: Words = ""


class Occasion(BookingEvent, frozen=True):
    """One time of a booking, from ``begins`` to ``ends`` (UTC ns)."""

    begins: int
    ends: int


@event("booking.neared")
class BookingNeared(Occasion, frozen=True):
    """A booking begins soon. LabOS notifies the users who have to clear the place."""


@event("booking.began")
class BookingBegan(Occasion, frozen=True):
    """The time of a booking has come."""


@event("booking.ended")
class BookingEnded(Occasion, frozen=True):
    """The time of a booking has ended. ``over``: the booking does not repeat again."""

    over: bool = False


class BookingSpan(msgspec.Struct, frozen=True, order=True):
    """One time of a booking (UTC ns)."""

    begins: int
    ends: int
    booking: str


class Booking(BookingTerms, frozen=True):
    """``made`` counts all bookings and changes: of two that overlap, the one with the higher count is valid.
    ``made_at`` is the time of its last change. ``skipped`` are the begins of times that are left out. Its
    times up to ``handled`` are over. ``neared`` and ``began`` are the begins of the next time and of the
    present time (0: none); ``until`` is the end of the present time. All times are in UTC ns."""

    made: int = 0
    made_at: int = 0
    skipped: tuple[int, ...] = ()
    handled: int = 0
    neared: int = 0
    began: int = 0
    until: int = 0

    @property
    def id(self) -> str:
        return self.booking

    @property
    def cell(self) -> str:
        """The workcell that is booked, or in which the module stands."""
        return workcell_of(ModuleName(self.target))

    @property
    def whom(self) -> str:
        """The owner of the booking as text."""
        if self.maintenance:
            return "maintenance"
        return f"the group {self.group}" if self.group else self.user

    def is_for(self, user: str, group: str) -> bool:
        """Whether a run of a user may continue during the booking. ``group`` is the user's group (empty:
        none)."""
        if self.maintenance:
            return False
        return bool(group) and group == self.group if self.group else user == self.user

    def list_spans(self, since: int, until: int) -> list[BookingSpan]:
        """The times of the booking that end after ``since`` and begin before ``until``, in order (UTC ns)."""
        length = self.ends - self.begins
        if not self.rule:
            starts = [self.begins]
        else:
            before = min(until, self.last + 1) if self.last else until
            starts = list_times_between(self.rule, self.zone, self.begins, since - length + 1, before)
        return [
            BookingSpan(begins, begins + length, self.id)
            for begins in starts
            if begins < until and begins + length > since and begins not in self.skipped
        ]

    def find_next_span(self, after: int) -> BookingSpan | None:
        """The first time of the booking that ends after ``after`` (UTC ns); None if there is none."""
        for days in (40, 400, 4_000, 40_000) if self.rule else (40_000,):
            found = self.list_spans(after, max(after, self.begins) + days * DAY_NS)
            if found:
                return found[0]
        return None

    @property
    def next_change(self) -> int:
        """The time of the booking's next change (UTC ns)."""
        if self.began:
            return self.until
        span = self.find_next_span(self.handled)
        if span is None:
            return self.handled
        return span.begins if self.neared == span.begins else span.begins - LEAD_NS

    def change_due(self, now: int) -> Change:
        """The change that is due now."""
        if self.began:
            return "end" if now >= self.until else ""
        span = self.find_next_span(self.handled)
        if span is None or now >= span.ends:
            return "end"
        if now >= span.begins:
            return "begin"
        return "near" if self.neared != span.begins and now >= span.begins - LEAD_NS else ""


class Bookings(msgspec.Struct):
    """``open`` are the bookings that are not over, by id. ``on`` are their ids by target, and ``now`` the
    bookings whose time it is. ``named`` counts the ids given out, ``made`` the bookings and changes, and
    ``events`` grows with each event about one."""

    open: dict[str, Booking] = {}
    on: dict[str, dict[str, bool]] = {}
    now: dict[str, bool] = {}
    named: int = 0
    made: int = 0
    events: int = 0

    @property
    def next_id(self) -> str:
        return f"B{self.named + 1}"

    def list_for(self, module: ModuleName) -> list[Booking]:
        """The bookings of a module and of its workcell."""
        places = (module, workcell_of(module))
        return [self.open[name] for place in places for name in self.on.get(place, ())]

    def list_in_cell(self, cell: str) -> list[Booking]:
        """The bookings of a workcell and of its modules."""
        return [booking for booking in self.open.values() if booking.cell == cell]


def fold_booking_made(bookings: Bookings, event: BookingMade, at: int) -> None:
    if event.booking in bookings.open:
        raise ValueError(f"{event.booking} is open already")
    bookings.named += 1
    _write(bookings, event, at)


def fold_booking_changed(bookings: Bookings, event: BookingChanged, at: int) -> None:
    before = bookings.open[event.booking]
    _drop(bookings, event.booking)
    is_same = (before.rule, before.begins, before.zone) == (event.rule, event.begins, event.zone)
    _write(bookings, event, at, skipped=before.skipped if is_same else (), handled=before.handled)


def fold_booking_cancelled(bookings: Bookings, event: BookingCancelled, at: int) -> None:
    _drop(bookings, event.booking)


def fold_booking_skipped(bookings: Bookings, event: BookingSkipped, at: int) -> None:
    booking = bookings.open[event.booking]
    changes: dict[str, Any] = {"skipped": (*booking.skipped, event.begins)}
    if booking.began == event.begins:
        changes |= {"began": 0, "until": 0}
        bookings.now.pop(event.booking, None)
    _change(bookings, event, **changes)


def fold_booking_neared(bookings: Bookings, event: BookingNeared, at: int) -> None:
    _change(bookings, event, neared=event.begins)


def fold_booking_began(bookings: Bookings, event: BookingBegan, at: int) -> None:
    _change(bookings, event, began=event.begins, until=event.ends)
    bookings.now[event.booking] = True


def fold_booking_ended(bookings: Bookings, event: BookingEnded, at: int) -> None:
    if event.over:
        _drop(bookings, event.booking)
        return
    _change(bookings, event, began=0, until=0, handled=event.ends)
    bookings.now.pop(event.booking, None)


def _write(bookings: Bookings, event: BookingMade | BookingChanged, at: int, **known: Any) -> None:
    bookings.made += 1
    bookings.events += 1
    bookings.open[event.booking] = make_from(Booking, event, made=bookings.made, made_at=at, **known)
    bookings.on.setdefault(event.target, {})[event.booking] = True


def _change(bookings: Bookings, event: BookingEvent, **changes: Any) -> None:
    bookings.events += 1
    bookings.open[event.booking] = msgspec.structs.replace(bookings.open[event.booking], **changes)


def _drop(bookings: Bookings, name: str) -> None:
    bookings.events += 1
    booking = bookings.open.pop(name)
    names = bookings.on[booking.target]
    del names[name]
    if not names:
        del bookings.on[booking.target]
    bookings.now.pop(name, None)
