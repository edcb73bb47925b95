"""Whether a module is booked for others: now, or before the end of a step.

For other users, a booked module is like one that is out of service for a time. Steps that only carry labware
out of the module may continue, because they make room for the booking. During maintenance no step may
continue, because a person may be reaching into the module.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache

import msgspec

from labos.core import reasons
from labos.core.bookings import Booking, BookingSpan
from labos.core.effects import list_carried
from labos.core.ids import ModuleName, workcell_of
from labos.core.model import PlanStep
from labos.core.recurrence import DAY_NS, in_zone
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.core.waits import Wait

HORIZON_DAYS = 14
HORIZON_NS = HORIZON_DAYS * DAY_NS
"""A gap between bookings is searched up to this far ahead."""


def booking_key(cell: str) -> str:
    """The key that is touched when a booking in a workcell changes, begins or ends."""
    return f"booking:{cell}"


def find_contacts(state: LabState, step: PlanStep) -> dict[ModuleName, bool]:
    """The modules that a step occupies or reaches into. The value is true if the step only carries labware
    out of the module."""
    found: dict[ModuleName, bool] = {}
    if step.exclusive:
        found[step.module] = False
    for what in list_carried(step.effects):
        for place in what.entered:
            station = state.bench.stations.get(place)
            if station is None or not station.spec.module or station.spec.stands_apart:
                continue
            clears = place == what.emptied and place not in what.room
            found[station.spec.module] = found.get(station.spec.module, True) and clears
    return found


def is_exempt(state: LabState, run: RunState, step: PlanStep) -> bool:
    """Whether a step ignores bookings: it resets a module, or moves arms away from a person."""
    access = state.lab.access.get(workcell_of(step.module))
    return step.recovers or (access is not None and run.plan in access.parking)


def list_bookings_of_others(
    state: LabState, user: str, module: ModuleName, *, clears: bool = False
) -> list[Booking]:
    """The bookings of a module, or of its workcell, that are for others than a user. With ``clears``, only
    maintenance."""
    if not state.bookings.open:
        return []
    group = state.shares.group_of.get(user, "")
    found = (booking for booking in state.bookings.list_for(module) if not booking.is_for(user, group))
    return [booking for booking in found if booking.maintenance or not clears]


def find_blocked(
    state: LabState, user: str, module: ModuleName, since: int, until: int, *, clears: bool = False
) -> list[BookingSpan]:
    """When a module is booked for others than a user from ``since`` to ``until`` (UTC ns), in order. A later
    booking for the user overrides earlier bookings of others, except for maintenance."""
    others = list_bookings_of_others(state, user, module, clears=clears)
    if not others:
        return []
    return list(_list_spans(others, _list_own(state, user, module), since, until))


def _list_own(state: LabState, user: str, module: ModuleName) -> list[Booking]:
    group = state.shares.group_of.get(user, "")
    return [booking for booking in state.bookings.list_for(module) if booking.is_for(user, group)]


def _list_spans(
    others: Iterable[Booking], own: Iterable[Booking], since: int, until: int
) -> list[BookingSpan]:
    found: list[BookingSpan] = []
    for booking in others:
        later = [mine for mine in own if mine.made > booking.made and not booking.maintenance]
        for span in booking.list_spans(since, until):
            parts = [span]
            for cut in (cut for mine in later for cut in mine.list_spans(span.begins, span.ends)):
                parts = [rest for part in parts for rest in _cut_out(part, cut)]
            found += [part for part in parts if part.begins < until and part.ends > since]
    return sorted(found)


def _cut_out(span: BookingSpan, cut: BookingSpan) -> Iterator[BookingSpan]:
    """The parts of a span that remain when another span is cut out of it."""
    if cut.ends <= span.begins or cut.begins >= span.ends:
        yield span
        return
    if span.begins < cut.begins:
        yield msgspec.structs.replace(span, ends=cut.begins)
    if cut.ends < span.ends:
        yield msgspec.structs.replace(span, begins=cut.ends)


def check_not_booked(state: LabState, run: RunState, step: PlanStep, now: int) -> Wait | None:
    """Whether no other user has booked a module that a step needs, from now until the planned end of the
    step."""
    if not state.bookings.open or is_exempt(state, run, step):
        return None
    length = max(1, int(step.duration_s * 1e9 / state.lab.pace))
    for module, clears in find_contacts(state, step).items():
        for span in find_blocked(state, run.user, module, now, now + length, clears=clears):
            never = check_gap(state, run.user, module, length, now, clears=clears)
            return never or make_wait(state, module, span, step.key, now)
    return None


def make_wait(
    state: LabState, module: ModuleName, span: BookingSpan, step: str, now: int, until: int | None = None
) -> Wait:
    """The wait of a step for the end of a booking, or until a later time with a gap that is long enough."""
    booking = state.bookings.open[span.booking]
    begins, ends = in_zone(span.begins, booking.zone), in_zone(span.ends, booking.zone)
    why: reasons.Booked | reasons.BookedSoon = reasons.Booked(module, booking.whom, ends, booking.id)
    if span.begins > now:
        why = reasons.BookedSoon(module, booking.whom, begins, ends, booking.id, step)
    on = (booking_key(workcell_of(module)),)
    return Wait(why, on, until=max(until or span.ends, now + 1))


def find_begun_booking(state: LabState, run: RunState, steps: Iterable[PlanStep]) -> Wait | None:
    """The first module of these steps whose booking for others has begun, or that has no gap that is long
    enough. A run that waits for it is blocked, as if the module were out of service."""
    if not state.bookings.open:
        return None
    longest: dict[tuple[ModuleName, bool], PlanStep] = {}
    for step in steps:
        for key in find_contacts(state, step).items() if not is_exempt(state, run, step) else ():
            if key not in longest or step.duration_s > longest[key].duration_s:
                longest[key] = step
    for (module, clears), step in longest.items():
        found = find_begun(state, run.user, module, clears=clears)
        if found is not None:
            span = BookingSpan(found.began, found.until, found.id)
            return make_wait(state, module, span, step.key, found.began)
        length = int(step.duration_s * 1e9 / state.lab.pace)
        wait = check_gap(state, run.user, module, length, state.recorded_at, clears=clears)
        if wait is not None:
            return wait
    return None


def find_begun(state: LabState, user: str, module: ModuleName, *, clears: bool = False) -> Booking | None:
    """The booking of a module for others than a user that has begun and is not over."""
    if not state.bookings.now:
        return None
    mine = [booking.made for booking in _list_own(state, user, module) if booking.id in state.bookings.now]
    for booking in list_bookings_of_others(state, user, module, clears=clears):
        over = not booking.maintenance and any(made > booking.made for made in mine)
        if booking.id in state.bookings.now and not over:
            return booking
    return None


def check_gap(
    state: LabState, user: str, module: ModuleName, length: int, now: int, *, clears: bool = False
) -> Wait | None:
    """The wait for a module whose bookings for others leave no gap of ``length`` (ns) within ``HORIZON_NS``;
    None if there is a gap."""
    others = list_bookings_of_others(state, user, module, clears=clears)
    if not others:
        return None
    gaps = _list_gaps(tuple(others), tuple(_list_own(state, user, module)), now // DAY_NS)
    if any(ends - max(begins, now) >= length for begins, ends in gaps):
        return None
    minutes = -(-length // 60_000_000_000)
    reason = reasons.NoGap(module, f"{minutes} min", str(HORIZON_DAYS), ", ".join(b.id for b in others))
    return Wait(reason, (booking_key(workcell_of(module)),), now + DAY_NS)


@lru_cache(maxsize=4096)
def _list_gaps(
    others: tuple[Booking, ...], own: tuple[Booking, ...], day: int
) -> tuple[tuple[int, int], ...]:
    """The times between bookings (UTC ns) of the days to come, today included."""
    time, end = day * DAY_NS, (day + HORIZON_DAYS + 1) * DAY_NS
    found: list[tuple[int, int]] = []
    for span in _list_spans(others, own, time, end):
        if span.begins > time:
            found.append((time, span.begins))
        time = max(time, span.ends)
    return (*found, (time, end)) if time < end else tuple(found)
