"""When a queued run should start: not long before its labware can leave the first place again.

The first step of a run takes its labware to a place that other runs need as well, such as the exchange of a
stack. If the next module is in use for a long time, the labware would stand there and block the place. So the
run waits outside until it would arrive at about the time when the next place becomes free.

That time is the lower end of a forecast: the run that blocks the next place continues without a stop, and
its steps take their shortest durations. So a run starts too early rather than too late. The forecast does
not count where nothing moves, or for a run that was overtaken too often.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from labos.core import reasons
from labos.core.actions import Action
from labos.core.bench import StationState
from labos.core.branches import list_all_before
from labos.core.effects import list_arrivals, list_carried
from labos.core.ids import Owner, RunId, StationName, run_owner, split_key, workcell_of
from labos.core.model import Plan, PlanStep
from labos.core.recurrence import in_zone
from labos.core.rules import convert_lab_s
from labos.core.runs import RunState, RunStatus, find_holds
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.planning.forecast import find_longest_time, find_pending_before, find_spread, is_pending
from labos.planning.touch import cell_key

LEAST_S = 1.0
"""The shortest wait outside (lab seconds). If an action takes longer than expected, the check is repeated,
with at least this pause."""


def check_arrival(state: LabState, run: RunState, step: int, now: int, others: Iterable[Plan]) -> Wait | None:
    """The wait of a queued run whose labware would block the place to which this first step brings it. None
    if the run may start. ``others`` are the plans of runs inside and of queued runs."""
    plan = state.runs.plan_of(run)
    if run.id in state.runs.windowed or not state.actions.is_any_moving(plan.workcell):
        return None
    first = _find_first_stop(state, plan, step)
    if first is None:
        return None
    stop, onward, after = first
    free_at = _find_free_time(state, onward, now)
    arrives = now + sum(find_longest_time(state, plan.steps[i]) for i in (step, *after))
    if free_at is None or free_at < arrives + convert_lab_s(state, LEAST_S):
        return None
    if not any(_leads_elsewhere(other, stop, onward) for other in others if other is not plan):
        return None
    why = reasons.WouldBlock(stop, onward, in_zone(free_at, "UTC"))
    return Wait(why, (cell_key(plan.workcell),), until=now + free_at - arrives)


def _find_first_stop(
    state: LabState, plan: Plan, step: int
) -> tuple[StationName, StationName, tuple[int, ...]] | None:
    """The place that a first step fills, the place to which labware is carried from there, and the steps in
    between. None if there is still room at the first place, or if no step of the run carries labware on."""
    stop = next((what.filled for what in list_carried(plan.steps[step].effects) if what.filled), None)
    if stop is None or not _would_fill(state.bench.stations[stop]):
        return None
    between: list[int] = []
    for index, later in enumerate(plan.steps):
        if index == step or step not in list_all_before(lambda at: plan.steps[at].after, index):
            continue
        for what in list_carried(later.effects):
            if what.emptied == stop:
                return (stop, what.filled, tuple(between)) if what.filled else None
        between.append(index)
    return None


def _would_fill(station: StationState) -> bool:
    return station.spec.kind != "waste" and station.count + 1 >= station.spec.capacity


def _leads_elsewhere(plan: Plan, stop: StationName, onward: StationName) -> bool:
    """Whether a plan carries labware from the place ``stop`` to another place than ``onward``."""
    moves = (what for step in plan.steps for what in list_carried(step.effects))
    return any(what.emptied == stop and what.filled != onward for what in moves)


def _find_free_time(state: LabState, place: StationName, now: int) -> int | None:
    """The earliest time at which a place can be entered (UTC ns); None if it is not known."""
    station = state.bench.stations[place]
    times = [now]
    for owner in _list_in_the_way(state, station):
        leaves = _find_leave_time(state, owner, place, now)
        if leaves is None:
            return None
        times.append(leaves)
    if station.spec.module and not station.spec.stands_apart:
        at_work = (
            a for a in state.actions.list_in_cell(workcell_of(place)) if a.module == station.spec.module
        )
        times += [_find_end_time(state, action, now) for action in at_work if action.exclusive]
    return max(times)


def _list_in_the_way(state: LabState, station: StationState) -> Iterator[Owner]:
    """The owners of labware at a place, or on its way there, that has to leave before more can come."""
    if not station.full and not station.spec.claim:
        return
    for labware in station.labware:
        yield state.bench.labware[labware].owner
    if station.expected:
        for action in state.actions.list_in_cell(workcell_of(station.spec.name)):
            if station.spec.name in list_arrivals(action.effects):
                yield run_owner(action.run)


def _find_leave_time(state: LabState, owner: Owner, place: StationName, now: int) -> int | None:
    """The earliest time at which a run has carried its labware away from a place (UTC ns). None if it does
    not do so, if it cannot continue now, or if the owner is no run inside."""
    kind, name = split_key(owner)
    run = state.runs.active.get(RunId(name)) if kind == "run" else None
    if run is None or run.status != RunStatus.ACTIVE or find_holds(run):
        return None
    plan = state.runs.plan_of(run)
    leaving = (
        index
        for index, step in enumerate(plan.steps)
        if is_pending(run, index) and any(what.emptied == place for what in list_carried(step.effects))
    )
    last = next(leaving, None)
    if last is None:
        return None
    flying = [action for action in state.actions.list_in_cell(plan.workcell) if action.run == run.id]
    begin = max([now, *(_find_end_time(state, action, now) for action in flying)])
    return begin + sum(
        _find_shortest_time(state, plan.steps[step]) for step in find_pending_before(run, plan, last)
    )


def _find_end_time(state: LabState, action: Action, now: int) -> int:
    """The earliest end of an action (UTC ns); now if that time has passed."""
    run = state.runs.active.get(action.run)
    if run is None:
        return now
    step = state.runs.plan_of(run).steps[action.step]
    return max(now, action.requested_at + _find_shortest_time(state, step))


def _find_shortest_time(state: LabState, step: PlanStep) -> int:
    return find_longest_time(state, step) - find_spread(state, step)
