"""Starts that would collide with a booking of others: they wait.

The check of a step includes labware that it leaves in a module, a door that it leaves open or shut, and a
module that it holds: each of them until a later step. The check of a new run includes all its steps.

Durations are the usual ones. If there is a time within ``HORIZON_NS`` at which all steps of a run have room
between the bookings, the run is admitted then. If not, each of its stays must have a long enough gap, and it
is admitted when its first step has room, with the steps that must follow in time. A run inside continues
while there is room. If there is none, it waits for the end of the booking: the rules do not allow its next
step before. While a booking has begun, safety counts such a run as stuck, as if the module were out of
service.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import msgspec

from labos.core.booked import HORIZON_NS, check_gap, find_blocked, find_contacts, is_exempt, make_wait
from labos.core.bookings import Bookings, BookingSpan
from labos.core.decide import Command
from labos.core.decide.bookings import BeginBooking, EndBooking, NearBooking
from labos.core.effects import Carrying, Sets, list_carried
from labos.core.ids import ModuleName, RunId, StationName, module_key
from labos.core.model import MAIN, Plan, PlanStep
from labos.core.runs import PENDING, RunState, list_statuses
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.planning.forecast import find_earliest_start, find_usual_time, takes_from
from labos.planning.player import find_chained


class ModuleUse(msgspec.Struct, frozen=True):
    """The time in which a run uses a module, or has labware in it (ns from now). It begins with ``step``. If
    the step only carries labware out (``clears``), only maintenance stops it."""

    module: ModuleName
    begins: int
    ends: int
    step: int
    clears: bool = False


def check_start(state: LabState, run: RunState, step: int, now: int) -> Wait | None:
    """The wait of a start that would collide with a booking; None if there is room. The rules must allow the
    start."""
    plan = state.runs.plan_of(run)
    if not state.bookings.list_in_cell(plan.workcell) or is_exempt(state, run, plan.steps[step]):
        return None
    times = _foresee_times(state, run, plan, step, now)
    wait = _check_times(state, run, step, now, times)
    if wait is None:
        return None
    # Durations are learned from the actions of these modules, and a shorter one may end the wait.
    modules = dict.fromkeys(module_key(plan.steps[index].module) for index in times)
    return msgspec.structs.replace(wait, on=(*wait.on, *modules))


def _check_times(
    state: LabState, run: RunState, step: int, now: int, times: dict[int, tuple[int, int]]
) -> Wait | None:
    """The same if the steps begin and end at these ``times`` (ns from now)."""
    plan = state.runs.plan_of(run)
    if not run.has_started:
        every = list(_list_stays(state, plan, times, times))
        for wait in _list_without_gap(state, run, every, now):
            return wait
        if _find_first_fit(state, run.user, every, now) is not None:
            return _check_room_for(state, run, plan, every, now)
    together = {step, *find_chained(run, plan, [step])}
    return _check_room_for(state, run, plan, list(_list_stays(state, plan, times, together)), now)


def find_next_collision(state: LabState, name: RunId, now: int) -> int | None:
    """The first time at which a waiting run, if started then, would collide with a booking with which it does
    not collide now (UTC ns). None if there is no such time within ``HORIZON_NS``."""
    run = state.runs.queued[name]
    plan = state.runs.plan_of(run)
    times = _foresee_times(state, run, plan, 0, now)
    found = (
        span.begins - stay.ends + 1
        for stay in _list_stays(state, plan, times, times)
        for span in find_blocked(
            state, run.user, stay.module, now + stay.begins, now + HORIZON_NS, clears=stay.clears
        )
    )
    return min((at for at in found if at > now), default=None)


def list_without_gap(state: LabState, run: RunState, now: int) -> list[Wait]:
    """The waits for modules on which bookings of others leave no long enough gap for a waiting run."""
    plan = state.runs.plan_of(run)
    if not state.bookings.list_in_cell(plan.workcell):
        return []
    times = _foresee_times(state, run, plan, 0, now)
    return list(_list_without_gap(state, run, _list_stays(state, plan, times, times), now))


def _list_without_gap(state: LabState, run: RunState, stays: Iterable[ModuleUse], now: int) -> Iterator[Wait]:
    """The waits for modules on which there is no gap for the longest of these stays."""
    longest: dict[tuple[ModuleName, bool], int] = {}
    for stay in stays:
        key = (stay.module, stay.clears)
        longest[key] = max(longest.get(key, 0), stay.ends - stay.begins)
    for (module, clears), length in longest.items():
        wait = check_gap(state, run.user, module, length, now, clears=clears)
        if wait is not None:
            yield wait


def _check_room_for(
    state: LabState, run: RunState, plan: Plan, stays: list[ModuleUse], now: int
) -> Wait | None:
    """The wait until there is room for all these stays; None if there is room now."""
    met = _find_first_met(state, run.user, stays, now)
    if met is None:
        return None
    stay, span = met
    for wait in _list_without_gap(state, run, stays, now):
        return wait
    return make_wait(
        state, stay.module, span, plan.steps[stay.step].key, now, _find_first_fit(state, run.user, stays, now)
    )


def _find_first_met(
    state: LabState, user: str, stays: Iterable[ModuleUse], now: int
) -> tuple[ModuleUse, BookingSpan] | None:
    for stay in stays:
        ends = max(stay.ends, stay.begins + 1)
        for span in find_blocked(state, user, stay.module, now + stay.begins, now + ends, clears=stay.clears):
            return stay, span
    return None


def _find_first_fit(state: LabState, user: str, stays: list[ModuleUse], now: int) -> int | None:
    """The first time at which all these stays have room if they are moved there together (UTC ns). None if
    there is no such time within ``HORIZON_NS``."""
    time = now
    while time <= now + HORIZON_NS:
        met = _find_first_met(state, user, stays, time)
        if met is None:
            return time
        stay, span = met
        time = span.ends - stay.begins
    return None


def _foresee_times(
    state: LabState, run: RunState, plan: Plan, first: int, now: int
) -> dict[int, tuple[int, int]]:
    """When each pending step would begin and end if ``first`` started now and nothing else caused a delay (ns
    from now)."""
    known: dict[int, int] = {}
    found: dict[int, tuple[int, int]] = {}
    statuses = list_statuses(plan, run)
    left = {
        i
        for i, status in enumerate(statuses)
        if status == PENDING and (run.has_started or plan.steps[i].part == MAIN)
    }
    while left:
        before_pass = len(left)
        for index in sorted(left):
            step = plan.steps[index]
            if not left.isdisjoint(step.after):
                continue
            begins = max([now, *(known.get(before, now) for before in step.after)])
            if index != first:
                begins = max(begins, find_earliest_start(state, run, index, known))
            known[index] = begins + find_usual_time(state, step)
            found[index] = (begins - now, known[index] - now)
            left.discard(index)
        if len(left) == before_pass:
            break  # the remaining steps wait for one another
    return found


def _list_stays(
    state: LabState, plan: Plan, times: dict[int, tuple[int, int]], steps: Iterable[int]
) -> Iterator[ModuleUse]:
    """The stays that these steps begin, each with its whole duration."""
    in_time = sorted(times, key=lambda index: times[index])
    for index in sorted(steps):
        if index not in times or plan.steps[index].recovers:
            continue
        begins, ends = times[index]
        step = plan.steps[index]
        for module, clears in find_contacts(state, step).items():
            last = (
                ends if clears else max([ends, *_list_end_times(state, plan, times, in_time, index, module)])
            )
            yield ModuleUse(module, begins, last, index, clears)
        for hold in plan.holds:
            if hold.first == index and hold.last in times:
                yield ModuleUse(hold.module, begins, max(ends, times[hold.last][1]), index)


def _list_end_times(
    state: LabState,
    plan: Plan,
    times: dict[int, tuple[int, int]],
    in_time: list[int],
    index: int,
    module: ModuleName,
) -> Iterator[int]:
    """The times at which the labware that a step brings into a module leaves it, and at which a door that it
    moves is at rest again (ns from now). If labware stays there after the run, the ends of all later steps at
    the module count: a longer stay is not known, and a person is informed of it."""
    step = plan.steps[index]
    if not any(isinstance(effect, Carrying | Sets) for effect in step.effects):
        return
    ends = times[index][1]
    later = [i for i in in_time if times[i][0] >= ends and i != index]
    for what in list_carried(step.effects):
        place = what.filled
        if place and _is_inside(state, place, module):
            gone = next((i for i in later if takes_from(plan.steps[i], place)), None)
            if gone is not None:
                yield times[gone][1]
            else:
                yield from (times[i][1] for i in later if module in find_contacts(state, plan.steps[i]))
    if step.module == module:
        yield from _list_closing_times(state, plan, times, later, step)


def _is_inside(state: LabState, place: StationName, module: ModuleName) -> bool:
    spec = state.bench.stations[place].spec
    return spec.module == module and not spec.stands_apart and spec.kind != "waste"


def _list_closing_times(
    state: LabState, plan: Plan, times: dict[int, tuple[int, int]], later: list[int], step: PlanStep
) -> Iterator[int]:
    """The times at which doors or lids that a step moves away from rest are at rest again (ns from now)."""
    known = state.modules.by_name.get(step.module)
    rest = known.spec.rest if known is not None else {}
    for effect in step.effects:
        if not isinstance(effect, Sets) or effect.of != "module" or effect.variable not in rest:
            continue
        value = rest[effect.variable]
        if effect.value == value:
            continue
        for i in later:
            other = plan.steps[i]
            sets = (e for e in other.effects if isinstance(e, Sets) and e.of == "module")
            if other.module == step.module and any(
                (e.variable, e.value) == (effect.variable, value) for e in sets
            ):
                yield times[i][1]
                break


class BookingTimes:
    """The times at which bookings of a state come near, begin and end. They are computed again when a booking
    has changed."""

    def __init__(self) -> None:
        self._seen: int | None = None
        self._first: int | None = None

    def find_first(self, bookings: Bookings) -> int | None:
        """The time of the earliest change that is due or in the future (UTC ns); None without bookings."""
        if not bookings.open:
            return None
        if self._seen != bookings.events:
            self._seen = bookings.events
            self._first = min(booking.next_change for booking in bookings.open.values())
        return self._first

    def iterate_due(self, bookings: Bookings, now: int) -> Iterator[Command]:
        """The commands for changes that are due, at most one for each booking."""
        first = self.find_first(bookings)
        if first is None or now < first:
            return
        for booking in list(bookings.open.values()):
            match booking.change_due(now):
                case "near":
                    yield NearBooking(booking.id, now)
                case "begin":
                    yield BeginBooking(booking.id, now)
                case "end":
                    yield EndBooking(booking.id, now)
                case _:
                    pass
