"""Following a suggested order.

A step waits while another that was suggested to go before it, and takes what it takes, has not started. That
is all a suggestion does: rules, windows, deadlock avoidance and the patience of others are asked as without
it. So that bad advice does little harm, a step waits for another only

- while something moves in the workcell: where nothing does, nobody waits for advice;
- until that other should have started, and ``GRACE_S`` after that;
- for ``MOST_S`` in all, whatever is suggested meanwhile;
- if its own run is not urgent, of a higher priority, or overtaken too often;
- if it is named in the order as well, or would not free what it takes before the other's time. What an
  order of the lab's own does not name always waits.

No step waits for so long that a clock of its own run, which runs already, would be late. Steps before it may
have ended sooner than planned, and the clock counts from there.

A step that starts a clock waits until its own time as well: what has to follow it was given its time by the
same plan. With the lab's own order where clocks run (``window_order``) so does a run that is to be let in.
So that windows are kept, the rehearsal tries the suggested times too (``keeping``).

A run that a planner lets wait outside (``Suggested.outside``) waits for its start in the same way, so that it
does not stand in others' way. An order of nothing but such starts orders nothing else.
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
"""So many lab seconds after its time a step that has not started keeps nobody waiting any more."""

MOST_S = 4 * 3600.0
"""No step waits longer than that (lab seconds) for advice, counted from when it could have started. With that
a planner that suggests again and again what cannot start stops nobody where something else always moves."""

LAST = 2**62


class OrderLookup(msgspec.Struct):
    """A suggestion, ready to be asked: when each step should start; by resource (the key of a module or
    station) the steps that take it, the earliest first; and by group of runs that wait in line, whose turn it
    should be in it. ``least`` is the lowest priority of its runs; ``kept_out`` are those that wait outside
    until their time."""

    order: OrderSuggested
    starts: dict[tuple[RunId, int], int]
    by_resource: dict[str, list[Suggested]]
    lines: dict[str, list[Suggested]]
    least: float = float("inf")
    kept_out: frozenset[RunId] = frozenset()


class Adviser:
    """The suggestions of one state after the other, each put in order once. Where nobody suggests an order,
    one counts that the lab has found by itself: ``own``, or ``windowed`` where clocks run."""

    def __init__(self, own: OwnOrders | None, windowed: Mapping[str, OrderSuggested]) -> None:
        self.own = own if own is not None else OwnOrders(enough=0)
        self._windowed = windowed
        self._known: dict[str, OrderLookup] = {}
        self._since: dict[tuple[RunId, int], int] = {}

    def start_of(self, state: LabState, run: RunState, step: int | None, now: int) -> int:
        """When a step (of a run that waits: its first one) should start; ``LAST`` if nothing is suggested."""
        advice = self._find_advice(state, state.runs.plan_of(run).workcell, now)
        if advice is None:
            return LAST
        if step is not None:
            return advice.starts.get((run.id, step), LAST)
        starts = state.runs.plans[run.plan].starts
        return min((advice.starts.get((run.id, first), LAST) for first in starts), default=LAST)

    def is_time(self, state: LabState, run: RunState, step: int, now: int) -> bool:
        """Whether a step should have started by now, by what was suggested."""
        advice = self._find_advice(state, state.runs.plan_of(run).workcell, now)
        return advice is not None and self.start_of(state, run, step, now) <= now

    def wake_in_time(self, state: LabState, run: RunState, step: int, wait: Wait, now: int) -> Wait:
        """The same wait, but until the time at which the step should start: no event marks that time."""
        begins = self.start_of(state, run, step, now) if state.suggestions.orders else LAST
        if now < begins < (LAST if wait.until is None else wait.until):
            return msgspec.structs.replace(wait, until=begins)
        return wait

    def find_next(self, state: LabState, run: RunState, now: int) -> RunState:
        """Who should be let in of those who wait in line with this run, the first of them."""
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
        """The wait of a start for steps that were suggested to go first; None if it may go ahead.
        ``follows_order`` tells whether all goes as suggested, and all windows are kept then: else a run with
        a running clock does not wait for the lab's own order."""
        plan = state.runs.plan_of(run)
        advice = self._find_advice(state, plan.workcell, now)
        if advice is None or plan.steps[step].part != MAIN or not state.actions.is_any_moving(plan.workcell):
            return None
        if run.has_started and run.status != RunStatus.ACTIVE:
            return None
        mine = advice.starts.get((run.id, step), LAST)
        urgent = is_urgent(state, run, now)
        goes_first = urgent or run.priority > advice.least
        is_own = advice.order.by in (OWN, OWN_WINDOWS)
        follows = follows_order is not None and advice.order.by == OWN_WINDOWS and follows_order()
        if advice.order.by == OWN_WINDOWS and _has_clock(state, run) and not follows:
            return None
        last = find_last_start(state, run, step)
        if now >= last:
            return None
        waits_outside = not run.has_started and (advice.order.by == OWN_WINDOWS or run.id in advice.kept_out)
        starts_clock = bool(list_clocked(state.runs.plans[run.plan], step))
        if now < mine < LAST and not goes_first and (waits_outside or starts_clock):
            if (is_own or waits_outside) and self._has_waited_enough(state, run, step, now):
                return None
            later = reasons.LaterHere if is_own or waits_outside else reasons.ClockLater
            why_later = later(plan.steps[step].key, in_zone(mine, "UTC"))
            return Wait(why_later, (cell_key(plan.workcell),), min(mine, last))
        for resource in _list_resources(state, plan.steps[step]):
            # The lab's own orders name all that should start soon: what they do not name comes after them.
            before = mine if mine < LAST or is_own else _find_release(state, plan, step, resource, now)
            for one in advice.by_resource.get(resource, ()):
                if one.start >= before:
                    break
                until = min(one.start + convert_lab_s(state, GRACE_S), advice.order.until)
                if one.run == run.id or until < now:
                    continue
                other = state.runs.get(one.run)
                if other is None or not is_pending(other, one.step) or find_holds(other):
                    continue
                if other.has_started and other.status != RunStatus.ACTIVE:
                    continue
                if run.priority > other.priority or (urgent and not is_urgent(state, other, now)):
                    continue
                if self._has_waited_enough(state, run, step, now):
                    return None
                enough = self._since[run.id, step] + convert_lab_s(state, MOST_S)
                why = reasons.SoonerAfter if is_own else reasons.AfterSuggested
                again, until = self.own.goes_on_at(plan.workcell), min(until, enough, last - 1) + 1
                return Wait(
                    why(str(other.id), split_key(resource)[1]),
                    (cell_key(plan.workcell),),
                    until if again is None else min(until, again),
                )
        return None

    def _has_waited_enough(self, state: LabState, run: RunState, step: int, now: int) -> bool:
        """Whether a step has waited for so long that no order counts for it any more."""
        since = self._since[run.id, step] = min(self._since.get((run.id, step), now), now)
        return since + convert_lab_s(state, MOST_S) < now

    def has_order(self, state: LabState, cell: str, now: int) -> bool:
        """Whether there is an order for a workcell."""
        return self._find_order(state, cell, now) is not None

    def has_orders(self, state: LabState) -> bool:
        """Whether there is an order for any workcell."""
        return bool(state.suggestions.orders or self.own or self._windowed)

    def _find_order(self, state: LabState, cell: str, now: int) -> OrderSuggested | None:
        return find_order(state, self._windowed, cell, now) or self.own.find(cell)

    def _find_starts(self, state: LabState, cell: str, now: int) -> OrderSuggested | None:
        """What a planner suggests, be it only when runs should start."""
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
    """The order of a workcell: the one that a planner suggests, else the lab's own where clocks run."""
    return find_suggested_order(state, cell, now) or windowed.get(cell)


def find_suggested_order(state: LabState, cell: str, now: int) -> OrderSuggested | None:
    """What a planner suggests, if that is more than when runs should start."""
    order = state.suggestions.find(cell, now)
    return order if order is not None and not all(one.outside for one in order.steps) else None


def find_suggested_times(
    state: LabState, order: OrderSuggested | None, now: int
) -> dict[tuple[RunId, int], int]:
    """When steps that have not started should start (UTC ns), if this order still counts."""
    if order is None or order.until <= now:
        return {}
    found: dict[tuple[RunId, int], int] = {}
    for one in order.steps:
        run = state.runs.get(one.run)
        if run is not None and is_pending(run, one.step):
            found[one.run, one.step] = one.start
    return found


def find_last_start(state: LabState, run: RunState, step: int) -> int:
    """When a step has to start at the latest (UTC ns), by usual durations, so that no window of its run whose
    clock runs is missed; ``LAST`` if none runs."""
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
    """Suggested times, but none so late that a running clock would be late, if that can still be helped."""
    found: dict[tuple[RunId, int], int] = {}
    for (name, step), at in times.items():
        run = state.runs.active.get(name)
        found[name, step] = at if run is None else min(at, max(now, find_last_start(state, run, step)))
    return found


def _has_clock(state: LabState, run: RunState) -> bool:
    """Whether a clock of a run runs."""
    windowed = state.runs.plans[run.plan].windowed if run.has_started else ()
    return any(is_pending(run, i) and find_deadline(state, run, i) is not None for i in windowed)


def _find_release(state: LabState, plan: Plan, step: int, resource: str, now: int) -> int:
    """When a step that starts now frees a resource again (UTC ns): a place that it fills, once a later step
    of its run has emptied it."""
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
        if is_first and not one.outside:  # others of its line do not wait with it
            advice.lines.setdefault(queue_key(state.runs.find_shape(run), run), []).append(one)
        for resource in _list_resources(state, state.runs.plan_of(run).steps[one.step]):
            advice.by_resource.setdefault(resource, []).append(one)
    advice.kept_out = frozenset(one.run for one in order.steps if one.outside)
    return advice


def _list_resources(state: LabState, step: PlanStep) -> list[str]:
    """The keys of what steps take in a suggested order: also the places that they fill."""
    filled = (what.filled for what in list_carried(step.effects) if what.filled)
    places = [p for p in filled if state.bench.stations[p].spec.kind not in ("stack", "waste")]
    return list(dict.fromkeys([*list_taken(state, step), *map(station_key, places)]))
