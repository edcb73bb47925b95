"""Booking a module or a workcell, and the changes of a booking."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import msgspec

from labos.core.bench import Labware
from labos.core.booked import find_begun, find_contacts
from labos.core.bookings import (
    Booking,
    BookingBegan,
    BookingCancelled,
    BookingChanged,
    BookingEnded,
    BookingMade,
    BookingNeared,
    BookingSkipped,
    BookingSpan,
)
from labos.core.decide._base import Command, Decision, InnerCommand, Rejection, decides
from labos.core.decide.limits import BAD_TEXT, find_fault
from labos.core.decide.lookups import decides_about, expect_booking, find_owner
from labos.core.ids import SHARED, ModuleName, local, workcell_of
from labos.core.recurrence import DAY_NS, LATEST, find_rule_fault, find_zone, in_zone
from labos.core.registry import Event
from labos.core.roles import rank_role_in
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.topics import BookedPlace, name_some, split_into_batches
from labos.core.users import find_person, rank
from labos.core.words import Words

HOUR_NS = 3_600_000_000_000

LONGEST_DAYS = 366
"""The longest time of a booking."""

CONFLICT_DAYS = 400
"""Overlaps of repeated bookings are checked up to this far ahead."""


class NewTerms(msgspec.Struct, frozen=True, kw_only=True):
    """The times of a booking (UTC ns), and its user or group; neither for ``maintenance``. With a ``rule`` it
    is repeated by the clock of a time zone, at the latest at ``last`` (UTC ns; 0: without end). ``why`` is
    null if a changed booking keeps its reason."""

    begins: int
    ends: int
    user: str = ""
    group: str = ""
    maintenance: bool = False
    why: Words | None = ""
    zone: str = "UTC"
    rule: str = ""
    last: int = 0


class MakeBooking(Command, frozen=True):
    """Book a module or a workcell. With ``force``, also where others have booked."""

    target: str
    terms: NewTerms
    by: str
    now: int
    force: bool = False


class ChangeBooking(Command, frozen=True):
    """Change the time or the owner of a booking. With ``force``, also where others have booked."""

    booking: str
    terms: NewTerms
    by: str
    now: int
    force: bool = False


class CancelBooking(Command, frozen=True):
    """Cancel a booking. If ``begins`` (UTC ns) is given, only this time of a repeated booking is
    cancelled."""

    booking: str
    by: str
    why: Words = ""
    begins: int = 0


class TurnBooking(InnerCommand, frozen=True):
    booking: str
    now: int


class NearBooking(TurnBooking, frozen=True):
    """A booking begins soon."""


class BeginBooking(TurnBooking, frozen=True):
    """The time of a booking has come."""


class EndBooking(TurnBooking, frozen=True):
    """The time of a booking is over."""


@decides(MakeBooking)
def make_booking(state: LabState, command: MakeBooking) -> Decision:
    over = _find_overridden(state, command.target, command, "")
    if isinstance(over, Rejection):
        return over
    return [_make_event(BookingMade, state.bookings.next_id, command.target, command, over)]


@decides_about(ChangeBooking, expect_booking)
def change_booking(state: LabState, command: ChangeBooking, booking: Booking) -> Decision:
    if command.terms.why is None:
        same = msgspec.structs.replace(command.terms, why=booking.why)
        command = msgspec.structs.replace(command, terms=same)
    over = _find_overridden(state, booking.target, command, booking.id)
    if isinstance(over, Rejection):
        return over
    return [_make_event(BookingChanged, booking.id, booking.target, command, over)]


@decides_about(CancelBooking, expect_booking)
def cancel_booking(state: LabState, command: CancelBooking, booking: Booking) -> Decision:
    if not command.begins or not booking.rule:
        return [BookingCancelled(booking.id, command.by, command.why)]
    times = booking.list_spans(command.begins, command.begins + 1)
    if not any(span.begins == command.begins for span in times):
        return Rejection(
            "no_time",
            f"The booking {booking.id} has no time that begins at {in_zone(command.begins, booking.zone)}.",
            f"Its times: labos calendar {local(booking.target)}",
        )
    return [BookingSkipped(booking.id, command.begins, command.by, command.why)]


def _find_due_span(state: LabState, command: NearBooking | BeginBooking) -> BookingSpan | None:
    """The next time of a booking if this change of it is due."""
    booking = state.bookings.open.get(command.booking)
    change = "near" if isinstance(command, NearBooking) else "begin"
    if booking is None or booking.change_due(command.now) != change:
        return None
    return booking.find_next_span(booking.handled)


@decides_about(NearBooking, _find_due_span)
def near_booking(state: LabState, command: NearBooking, span: BookingSpan) -> Decision:
    return [BookingNeared(command.booking, span.begins, span.ends)]


@decides_about(BeginBooking, _find_due_span)
def begin_booking(state: LabState, command: BeginBooking, span: BookingSpan) -> Decision:
    return [BookingBegan(command.booking, span.begins, span.ends)]


@decides(EndBooking)
def end_booking(state: LabState, command: EndBooking) -> Decision:
    """Several times that passed while the lab was down are over at once."""
    booking = state.bookings.open.get(command.booking)
    if booking is None or booking.change_due(command.now) != "end":
        return []
    last = BookingSpan(booking.began, booking.until, booking.id)
    if not booking.began:
        missed = [
            span for span in booking.list_spans(booking.handled, command.now) if span.ends <= command.now
        ]
        last = missed[-1] if missed else BookingSpan(booking.begins, booking.ends, booking.id)
    over = booking.find_next_span(max(last.ends, booking.handled)) is None
    return [BookingEnded(booking.id, last.begins, last.ends, over)]


def list_modules(state: LabState, target: str) -> list[ModuleName]:
    """The modules that are booked with a module or a workcell."""
    return [name for name in state.modules.by_name if target in (name, workcell_of(name))]


# -- what a booking has to keep --------------------------------------------------------------------


def _make_event(
    kind: type[BookingMade] | type[BookingChanged],
    name: str,
    target: str,
    command: MakeBooking | ChangeBooking,
    over: tuple[str, ...],
) -> Event:
    terms = command.terms
    return make_from(kind, terms, booking=name, target=target, by=command.by, why=terms.why or "", over=over)


def _find_overridden(
    state: LabState, target: str, command: MakeBooking | ChangeBooking, name: str
) -> tuple[str, ...] | Rejection:
    """The bookings that a booking overrides, or why it cannot be made. ``name`` is its id, if it has one."""
    return (
        _check_terms(state, target, command.terms, command.now)
        or _check_quota(state, target, command, name)
        or _find_conflicts(state, target, command, name)
    )


def _check_terms(state: LabState, target: str, terms: NewTerms, now: int) -> Rejection | None:
    for field in ("user", "group", "zone", "rule"):
        if fault := find_fault(getattr(terms, field), field):
            return Rejection(BAD_TEXT, fault, "Shorten it.")
    if target not in state.lab.workcells and ModuleName(target) not in state.modules.by_name:
        return Rejection("no_target", f"There is no module or workcell {target!r}.", "List them: labos nodes")
    if terms.ends <= terms.begins:
        return Rejection("bad_time", "A booking ends after it begins.", "Exchange --from and --to.")
    if terms.ends <= now and not terms.rule:
        return Rejection("past", "The time to book is in the past.", "Choose a later one.")
    if terms.ends - terms.begins > LONGEST_DAYS * DAY_NS or terms.ends > LATEST:
        return Rejection("bad_time", f"A booking lasts {LONGEST_DAYS} days at most, and ends before 2100.")
    return _check_rule(terms, now) or _check_for_whom(state, terms)


def _check_rule(terms: NewTerms, now: int) -> Rejection | None:
    try:
        find_zone(terms.zone)
    except ValueError as error:
        return Rejection("bad_zone", f"{error}.", "Write one like Europe/Zurich, or UTC.")
    if not terms.rule:
        if terms.last:
            return Rejection("bad_rule", "Only a repeated booking can have a last time.", "Add --every.")
        return None
    fault = find_rule_fault(terms.rule, terms.zone, terms.begins)
    if fault:
        return Rejection("bad_rule", fault, "Add how often: --every day, week, weekday, '2 weeks' or month.")
    booking = _as_booking("", "", terms)
    times = booking.list_spans(terms.begins, terms.begins + CONFLICT_DAYS * DAY_NS)
    if any(later.begins < earlier.ends for earlier, later in pairwise(times)):
        return Rejection(
            "bad_rule", "It would last longer than the time until its next repetition.", "Book it less often."
        )
    if booking.find_next_span(now) is None:
        return Rejection("past", "The time to book is in the past.", "Choose a later one.")
    return None


def _check_for_whom(state: LabState, terms: NewTerms) -> Rejection | None:
    if (bool(terms.user), bool(terms.group), terms.maintenance).count(True) != 1:
        return Rejection(
            "for_whom", "A booking is for one group, for one user, or for maintenance.", "Add --for NAME."
        )
    if terms.group and terms.group not in state.shares.groups:
        return Rejection("no_group", f"There is no group {terms.group!r}.", "List them: labos group list")
    if terms.user and not state.users.is_open and terms.user not in state.users.known:
        return Rejection("no_user", f"There is no user {terms.user!r}.", "List them: labos user list")
    return None


def _check_quota(
    state: LabState, target: str, command: MakeBooking | ChangeBooking, name: str
) -> Rejection | None:
    """Check the policy's limits for users who are not operators there: how much, and how far ahead, they may
    book."""
    who, terms, now = find_person(command.by), command.terms, command.now
    cell = workcell_of(ModuleName(target))
    if state.users.is_open or rank_role_in(state, who, cell) >= rank("operator"):
        return None
    limits, remedy = state.approvals.policy.bookings, "Ask an operator to book it."
    if terms.begins > now + limits.days_ahead * DAY_NS:
        return Rejection("too_far", f"{who} may book {limits.days_ahead} days ahead at most.", remedy)
    long = (terms.ends - terms.begins) / HOUR_NS
    if limits.hours is not None and long > limits.hours:
        what = f"This booking lasts {long:.1f} h; bookings of {who} may last at most {limits.hours:g} h."
        return Rejection("too_long", what, f"Book a shorter time. {remedy}")
    mine = [
        b for b in state.bookings.open.values() if find_person(b.by) == who and b.id != name and not b.rule
    ]
    hours = (sum(b.ends - max(b.begins, now) for b in mine) + terms.ends - max(terms.begins, now)) / HOUR_NS
    if hours > limits.total_hours:
        return Rejection(
            "quota",
            f"{who} would have {hours:.1f} h booked in the future; at most {limits.total_hours:g} h "
            "are allowed.",
            "Give one back (labos book cancel), or ask an operator to book it.",
        )
    return None


def _find_conflicts(
    state: LabState, target: str, command: MakeBooking | ChangeBooking, name: str
) -> tuple[str, ...] | Rejection:
    mine = _as_booking(name, target, command.terms)
    whole = target in state.lab.workcells
    others = state.bookings.list_in_cell(target) if whole else state.bookings.list_for(ModuleName(target))
    since = max(command.now, mine.begins)
    until = since + CONFLICT_DAYS * DAY_NS if mine.rule else mine.ends
    times = mine.list_spans(since, until)
    over: list[str] = []
    for other in others:
        if other.id == name:
            continue
        met = _find_first_overlap(times, other.list_spans(since, max(until, times[-1].ends if times else 0)))
        if met is None:
            continue
        if command.force and (mine.maintenance or not other.maintenance):
            over.append(other.id)
            continue
        return _refuse(other, met, force=command.force)
    return tuple(sorted(over))


def _refuse(other: Booking, met: BookingSpan, *, force: bool) -> Rejection:
    begins, ends = in_zone(met.begins, other.zone), in_zone(met.ends, other.zone)
    what = f"{local(other.target)} is booked for {other.whom} from {begins} until {ends}"
    remedy = f"Choose another time, or ask {other.by}. An admin can book over it: --force"
    if force:
        remedy = (
            "A booking cannot overlap maintenance. Change the maintenance first: labos book change "
            f"{other.id}"
        )
    return Rejection("booked", f"{what}: {other.id}.", remedy)


def _find_first_overlap(ours: list[BookingSpan], others: list[BookingSpan]) -> BookingSpan | None:
    """The first of the others' times that overlaps one of ours; both lists are in order."""
    index = 0
    for span in others:
        while index < len(ours) and ours[index].ends <= span.begins:
            index += 1
        if index < len(ours) and ours[index].begins < span.ends:
            return span
    return None


def _as_booking(name: str, target: str, terms: NewTerms) -> Booking:
    return make_from(Booking, terms, booking=name, target=target, by="", why="")


# -- reactions -------------------------------------------------------------------------------------


def ask_to_clear_booking(state: LabState, event: BookingNeared) -> Iterator[Event]:
    """Before a booking begins, a person is asked to remove the labware of other users from the booked
    place."""
    yield from _ask(state, state.bookings.open[event.booking], event.begins)


def ask_about_overrun(state: LabState, event: BookingBegan) -> Iterator[Event]:
    """Actions that are under way when a booking begins continue to their end, and a person is notified."""
    booking = state.bookings.open[event.booking]
    for module in list_modules(state, booking.target):
        for action in [state.actions.open[name] for name in state.modules.by_name[module].in_flight]:
            run = state.runs.active.get(action.run)
            if run is None or find_begun(state, run.user, module) is not booking:
                continue
            plan = state.runs.plan_of(run)
            step = plan.steps[action.step]
            if step.recovers or not find_contacts(state, step):
                continue
            yield state.interventions.ask(
                BookedPlace(module=module, booking=booking.id, action=action.id),
                f"{local(booking.target)} is booked for {booking.whom} from now until "
                f"{in_zone(event.ends, booking.zone)} ({booking.id}), and step {step.key!r} of {run.id} "
                f"({run.user}) is still under way on {local(module)}. It goes on to its end.",
            )
    asked = [question.topic for question in state.interventions.list_about(_make_subject(booking.id))]
    if not any(isinstance(topic, BookedPlace) and topic.labware for topic in asked):
        yield from _ask(state, booking, event.begins)


def _ask(state: LabState, booking: Booking, begins: int) -> Iterator[Event]:
    found = [
        (module, item)
        for module in list_modules(state, booking.target)
        for item in _list_standing(state, module)
    ]
    items = [item for _, item in found if not _is_theirs(state, booking, item)]
    if not items:
        return
    for some in split_into_batches(BookedPlace, items):
        where = next(module for module, item in found if item is some[0])
        stands = name_some([f"{i.id} of {_owner(i)} at {local(i.station)}" for i in some])
        yield state.interventions.ask(
            BookedPlace(module=where, booking=booking.id, labware=tuple(item.id for item in some)),
            f"{local(booking.target)} is booked for {booking.whom} from "
            f"{in_zone(begins, booking.zone)} ({booking.id}), and this labware stands there: "
            f"{stands}. What no run moves away before that will stay there during the booking. Remove "
            "it and report that (labos unload), or leave it.",
        )


def _list_standing(state: LabState, module: ModuleName) -> list[Labware]:
    """Labware in a module, without labware in waste or in storage that is accessible separately."""
    stations = [state.bench.stations[name] for name in state.bench.by_module.get(module, ())]
    inside = [station for station in stations if not station.spec.stands_apart]
    return [state.bench.labware[name] for station in inside for name in station.labware]


def _is_theirs(state: LabState, booking: Booking, item: Labware) -> bool:
    """Whether labware is shared, or belongs to a person with the booking."""
    if item.owner == SHARED:
        return True
    user = find_owner(state, item.owner)
    return bool(user) and booking.is_for(user, state.shares.group_of.get(user, ""))


def _owner(item: Labware) -> str:
    return item.owner.replace(":", " ") or "nobody"


def _make_subject(booking: str) -> str:
    return BookedPlace(booking=booking).subject


def withdraw_booking_questions(
    state: LabState, event: BookingChanged | BookingCancelled | BookingSkipped | BookingEnded
) -> Iterator[Event]:
    """The questions about a booking are withdrawn when it changes or ends."""
    for question in state.interventions.list_about(_make_subject(event.booking)):
        yield question.withdraw("the booking is over, or another one")


def withdraw_cleared_booking_question(state: LabState, event: Event) -> Iterator[Event]:
    """The question about a booked place is withdrawn when the labware has left, or the action has ended."""
    if not state.bookings.open:
        return
    for question in state.interventions.open_about(BookedPlace):
        topic = question.topic
        if not isinstance(topic, BookedPlace):
            continue
        booking = state.bookings.open.get(topic.booking)
        if booking is None:
            continue
        if topic.action:
            still = topic.action in state.actions.open
        else:
            modules = list_modules(state, booking.target)
            standing = {item.id for module in modules for item in _list_standing(state, module)}
            still = any(name in standing for name in topic.labware)
        if not still:
            yield question.withdraw("the place is clear")
