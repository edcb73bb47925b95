"""Following a suggested order.

A step waits while another step has not started that is earlier in the order and needs the same module, zone
or place. Rules, windows, deadlock avoidance and the limit for overtakings are checked as without an order.
Bad advice must do little harm. So a step waits for another step only

- while something moves in the workcell;
- until ``GRACE_S`` after the time at which the other step should have started;
- for ``MOST_S`` in all, whatever is suggested meanwhile;
- if its run has no higher priority, is not more urgent, and was not overtaken too often;
- if the order names it too, or if it would not release what it takes before the other step's time. A step
  that the lab's own order does not name always waits.

No step waits so long that its run would miss a window whose clock is running. The order alone could cause
this: earlier steps may have ended sooner than planned, and the clock counts from their end.

A step that starts a clock also waits until its own suggested time, because the steps that have to follow it
have their times from the same plan. With the lab's own order where clocks run (``window_order``), a queued
run does the same. So that windows are kept, the rehearsal tries the suggested times too (``keeping``).

A planner may let a run wait outside (``Suggested.outside``), so that it does not block other runs. Such a run
waits for its suggested start in the same way. An order that has only such starts orders nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import msgspec

from labos.core import reasons
from labos.core.effects import list_carried
from labos.core.ids import RunId, split_key, station_key
from labos.core.model import MAIN, Plan, PlanStep
from labos.core.recurrence import in_zone
from labos.core.rules import convert_lab_s
from labos.core.runs import RunState, RunStatus, find_holds, queue_key
from labos.core.state import LabState
from labos.core.suggestions import OrderSuggested, Suggested
from labos.core.waits import Wait
from labos.planning.forecast import (
    find_deadline,
    find_pending_before,
    find_usual_time,
    is_pending,
    list_clocked,
)
from labos.planning.own_order import OWN, OwnOrders
from labos.planning.taken import list_taken
from labos.planning.touch import cell_key
from labos.planning.urgency import is_urgent
from labos.planning.window_order import OWN_WINDOWS

GRACE_S = 60.0
"""This many lab seconds after its suggested time, no other step waits for a step that has not started."""

MOST_S = 4 * 3600.0
"""The longest time that a step waits for orders (lab seconds), from when it could have started. So a planner
that repeatedly suggests what cannot start stops no step permanently, even if something else always moves."""

LAST = 2**62
"""The suggested start of a step for which nothing is suggested."""


class OrderLookup(msgspec.Struct):
    """An order, prepared for look-up. ``starts``: when each step should start (UTC ns). ``by_resource``: the
    steps that take a module, zone or station (by its key), the earliest first. ``lines``: for each class of
    queued runs (``queue_key``), their first steps in this order. ``least``: the lowest priority of its runs.
    ``kept_out``: the runs that wait outside until their time."""

    order: OrderSuggested
    starts: dict[tuple[RunId, int], int]
    by_resource: dict[str, list[Suggested]]
    lines: dict[str, list[Suggested]]
    least: float = float("inf")
    kept_out: frozenset[RunId] = frozenset()


class Adviser:
    """Looks up steps in the orders that count; each order is prepared once. Without a planner's order, the
    lab's own order counts: ``windowed`` where clocks run, else ``own``."""

    def __init__(self, own: OwnOrders | None, windowed: Mapping[str, OrderSuggested]) -> None:
        self.own = own if own is not None else OwnOrders(enough=0)
        self._windowed = windowed
        self._known: dict[str, OrderLookup] = {}
        self._since: dict[tuple[RunId, int], int] = {}

    def start_of(self, state: LabState, run: RunState, step: int | None, now: int) -> int:
        """When a step should start (UTC ns); ``LAST`` if nothing is suggested. With ``step`` None, the run is
        queued, and the earliest of its first steps counts."""
        advice = self._find_advice(state, state.runs.plan_of(run).workcell, now)
        if advice is None:
            return LAST
        if step is not None:
            return advice.starts.get((run.id, step), LAST)
        starts = state.runs.plans[run.plan].starts
        return min((advice.starts.get((run.id, first), LAST) for first in starts), default=LAST)

    def wake_in_time(self, state: LabState, run: RunState, step: int, wait: Wait, now: int) -> Wait:
        """The same wait, but at most until the suggested start of the step: no event marks that time."""
        begins = self.start_of(state, run, step, now) if state.suggestions.orders else LAST
        if now < begins < (LAST if wait.until is None else wait.until):
            return msgspec.structs.replace(wait, until=begins)
        return wait

    def find_next(self, state: LabState, run: RunState, now: int) -> RunState:
        """The run that should start next among the queued runs of one class, by the order. ``run`` is the
        first of them; it is returned if nothing is suggested."""
        advice = self._find_advice(state, state.runs.plan_of(run).workcell, now)
        key = queue_key(state.runs.find_shape(run), run)
        for one in advice.lines.get(key, ()) if advice is not None else ():
            other = state.runs.queued.get(one.run)
            if (
                other is not None
                and queue_key(state.runs.find_shape(other), other) == key
                and not find_holds(other)
            ):
                return other
        return run

    def check_start(
        self,
        state: LabState,
        run: RunState,
        step: int,
        now: int,
        follows_order: Callable[[], bool] | None = None,
    ) -> Wait | None:
        """The wait of a step for steps that should go first, or for its own suggested time. None if it may
        start. ``follows_order`` returns whether all goes as suggested and all windows are kept. Otherwise a
        run with a running clock does not wait for the lab's own order where clocks run."""
        plan = state.runs.plan_of(run)
        advice = self._find_advice(state, plan.workcell, now)
        if advice is None or plan.steps[step].part != MAIN or not state.actions.is_any_moving(plan.workcell):
            return None
        if run.has_started and run.status != RunStatus.ACTIVE:
            return None
        mine = advice.starts.get((run.id, step), LAST)
        is_own = advice.order.by in (OWN, OWN_WINDOWS)
        follows = follows_order is not None and advice.order.by == OWN_WINDOWS and follows_order()
        if advice.order.by == OWN_WINDOWS and _has_clock(state, run) and not follows:
            return None
        last = find_last_start(state, run, step)
        if now >= last:
            return None
        waits_outside = not run.has_started and (advice.order.by == OWN_WINDOWS or run.id in advice.kept_out)
        starts_clock = bool(list_clocked(state.runs.plans[run.plan], step))
        goes_first = run.priority > advice.least or is_urgent(state, run, now)
        if now < mine < LAST and not goes_first and (waits_outside or starts_clock):
            if (is_own or waits_outside) and self._has_waited_enough(state, run, step, now):
                return None
            later = reasons.LaterHere if is_own or waits_outside else reasons.ClockLater
            why_later = later(plan.steps[step].key, in_zone(mine, "UTC"))
            return Wait(why_later, (cell_key(plan.workcell),), min(mine, last))
        found = _find_step_before(state, run, step, advice, now)
        if found is None or self._has_waited_enough(state, run, step, now):
            return None
        first, resource = found
        enough = self._since[run.id, step] + convert_lab_s(state, MOST_S)
        until = min(_find_end_of_grace(state, advice, first), enough, last - 1) + 1
        again = self.own.goes_on_at(plan.workcell)
        why = reasons.SoonerAfter if is_own else reasons.AfterSuggested
        return Wait(
            why(str(first.run), split_key(resource)[1]),
            (cell_key(plan.workcell),),
            until if again is None else min(until, again),
        )

    def _has_waited_enough(self, state: LabState, run: RunState, step: int, now: int) -> bool:
        """Whether a step has waited for orders longer than ``MOST_S``. The first call notes the time."""
        since = self._since[run.id, step] = min(self._since.get((run.id, step), now), now)
        return since + convert_lab_s(state, MOST_S) < now

    def has_order(self, state: LabState, cell: str, now: int) -> bool:
        """Whether there is an order for a workcell. One that only lets runs wait outside does not count."""
        return self._find_order(state, cell, now) is not None

    def has_orders(self, state: LabState) -> bool:
        """Whether there may be an order for any workcell. A suggestion that is over counts too."""
        return bool(state.suggestions.orders or self.own or self._windowed)

    def _find_order(self, state: LabState, cell: str, now: int) -> OrderSuggested | None:
        return find_order(state, self._windowed, cell, now) or self.own.find(cell)

    def _find_starts(self, state: LabState, cell: str, now: int) -> OrderSuggested | None:
        """What a planner suggests, even if it only lets runs wait outside; else the order of the workcell."""
        return state.suggestions.find(cell, now) or self._find_order(state, cell, now)

    def _find_advice(self, state: LabState, cell: str, now: int) -> OrderLookup | None:
        order = self._find_starts(state, cell, now)
        if order is None or order.until <= now:
            return None
        known = self._known.get(cell)
        if known is None or known.order is not order:
            known = self._known[cell] = _put_in_order(state, order)
            self._since = {who: at for who, at in self._since.items() if state.runs.get(who[0]) is not None}
        return known


def find_order(
    state: LabState, windowed: Mapping[str, OrderSuggested], cell: str, now: int
) -> OrderSuggested | None:
    """The order of a workcell: a planner's, else the lab's own where clocks run. None if there is neither."""
    return find_suggested_order(state, cell, now) or windowed.get(cell)


def find_suggested_order(state: LabState, cell: str, now: int) -> OrderSuggested | None:
    """What a planner suggests; None if there is nothing, or if it only lets runs wait outside."""
    order = state.suggestions.find(cell, now)
    return order if order is not None and not all(one.outside for one in order.steps) else None


def find_suggested_times(
    state: LabState, order: OrderSuggested | None, now: int
) -> dict[tuple[RunId, int], int]:
    """When steps that have not started should start (UTC ns); empty if the order does not count any more."""
    if order is None or order.until <= now:
        return {}
    found: dict[tuple[RunId, int], int] = {}
    for one in order.steps:
        run = state.runs.get(one.run)
        if run is not None and is_pending(run, one.step):
            found[one.run, one.step] = one.start
    return found


def find_last_start(state: LabState, run: RunState, step: int) -> int:
    """The latest start of a step (UTC ns), by usual durations, with which its run misses no window with a
    running clock. ``LAST`` if there is no such window. Windows that are missed already do not count."""
    last, plan = LAST, state.runs.plan_of(run)
    for index in state.runs.plans[run.plan].windowed if run.has_started else ():
        if not is_pending(run, index) or run.is_breached(index):
            continue
        deadline = find_deadline(state, run, index)
        if deadline is None:
            continue
        before = find_pending_before(run, plan, index)
        if step in before:
            left = [] if step == index else before[:-1]
            last = min(last, deadline - sum(find_usual_time(state, plan.steps[i]) for i in left))
    return last


def bring_forward(
    state: LabState, times: Mapping[tuple[RunId, int], int], now: int
) -> dict[tuple[RunId, int], int]:
    """The suggested times. A time at which its run would miss a window with a running clock becomes earlier,
    but not earlier than ``now``."""
    found: dict[tuple[RunId, int], int] = {}
    for (name, step), at in times.items():
        run = state.runs.active.get(name)
        found[name, step] = at if run is None else min(at, max(now, find_last_start(state, run, step)))
    return found


def _find_step_before(
    state: LabState, run: RunState, step: int, advice: OrderLookup, now: int
) -> tuple[Suggested, str] | None:
    """The first step of an order for which a step waits, and the key of what both need. None if there is
    none."""
    plan = state.runs.plan_of(run)
    mine = advice.starts.get((run.id, step), LAST)
    # The lab's own orders name all steps that should start soon. Other steps come after them.
    is_named = mine < LAST or advice.order.by in (OWN, OWN_WINDOWS)
    for resource in _list_resources(state, plan.steps[step]):
        before = mine if is_named else _find_release(state, plan, step, resource, now)
        for one in advice.by_resource.get(resource, ()):
            if one.start >= before:
                break
            is_late = _find_end_of_grace(state, advice, one) < now
            if one.run != run.id and not is_late and _goes_before(state, one, run, now):
                return one, resource
    return None


def _goes_before(state: LabState, one: Suggested, run: RunState, now: int) -> bool:
    """Whether a suggested step may still go before a run's step: it can start, and its run does not rank
    lower."""
    other = state.runs.get(one.run)
    if other is None or not is_pending(other, one.step) or find_holds(other):
        return False
    if other.has_started and other.status != RunStatus.ACTIVE:
        return False
    if run.priority > other.priority:
        return False
    return is_urgent(state, other, now) or not is_urgent(state, run, now)


def _find_end_of_grace(state: LabState, advice: OrderLookup, one: Suggested) -> int:
    """Until when others wait for a suggested step (UTC ns)."""
    return min(one.start + convert_lab_s(state, GRACE_S), advice.order.until)


def _has_clock(state: LabState, run: RunState) -> bool:
    """Whether a clock of a run is running for a step that has not started."""
    windowed = state.runs.plans[run.plan].windowed if run.has_started else ()
    return any(is_pending(run, i) and find_deadline(state, run, i) is not None for i in windowed)


def _find_release(state: LabState, plan: Plan, step: int, resource: str, now: int) -> int:
    """When a step that starts now releases a resource (UTC ns), by usual durations: when it ends. It releases
    a place that it fills when a later step of its run has emptied it."""
    release = now
    for later in plan.steps[step:]:
        release += find_usual_time(state, later)
        filled = (station_key(what.filled) for what in list_carried(plan.steps[step].effects) if what.filled)
        emptied = (station_key(what.emptied) for what in list_carried(later.effects) if what.emptied)
        if resource in emptied or resource not in filled:
            break
    return release


def _put_in_order(state: LabState, order: OrderSuggested) -> OrderLookup:
    advice = OrderLookup(order, {}, {}, {})
    for one in order.steps:
        run = state.runs.get(one.run)
        if run is None:
            continue
        advice.starts[one.run, one.step] = one.start
        advice.least = min(advice.least, run.priority)
        is_first = not run.has_started and one.step in state.runs.plans[run.plan].starts
        if is_first and not one.outside:  # the other runs of its class do not wait outside
            advice.lines.setdefault(queue_key(state.runs.find_shape(run), run), []).append(one)
        for resource in _list_resources(state, state.runs.plan_of(run).steps[one.step]):
            advice.by_resource.setdefault(resource, []).append(one)
    advice.kept_out = frozenset(one.run for one in order.steps if one.outside)
    return advice


def _list_resources(state: LabState, step: PlanStep) -> list[str]:
    """The keys of what a step takes in an order. Places that it fills count too, except stacks and waste."""
    filled = (what.filled for what in list_carried(step.effects) if what.filled)
    places = [p for p in filled if state.bench.stations[p].spec.kind not in ("stack", "waste")]
    return list(dict.fromkeys([*list_taken(state, step), *map(station_key, places)]))
