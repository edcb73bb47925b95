"""Searches for a good schedule with OR-tools' CP-SAT (the extra ``plan``)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING

import msgspec
from msgspec.structs import replace

from labos.errors import SystemFailed
from labos.planner.measure import GOES_ON
from labos.planner.problem import SchedulingProblem, SetupCosts, Task, TimeLag
from labos.planning.waiting import PATIENCE

if TYPE_CHECKING:
    from ortools.sat.python import cp_model

TIDY = 0.3
"""The part of the time in which each run is moved to an earlier end, after a schedule for the whole was
found."""

FIRST = 8
"""The weight of a run's end for each class before which the run goes, and of each second after its campaign's
deadline."""

BOOKED_UNIT_S = 10.0


class Schedule(msgspec.Struct, frozen=True):
    """The start of each task (lab seconds from now), and the length of the whole. ``proven``: no schedule is
    better. ``cost`` is what the search made as small as it could."""

    starts_s: tuple[float, ...]
    makespan_s: float
    proven: bool
    cost: float = 0.0


def expect_solver() -> None:
    """Raises SystemFailed if OR-tools are not installed."""
    if find_spec("ortools") is None:
        raise SystemFailed(
            "The planner needs OR-tools, which are not installed.",
            remedy='Install them: python -m pip install "labos-sdl[plan]"',
        )


def solve(
    problem: SchedulingProblem,
    seconds: float,
    hint: Mapping[int, float] | None = None,
    *,
    counted: bool = False,
) -> Schedule | None:
    """The best schedule that is found in so many seconds of wall time; None if there is none. ``hint`` are
    the starts (lab seconds) in a known schedule, by task. One search begins there; a schedule that misses
    windows is looked for only if the known one misses some, or if no other is possible. With windows, this
    search stays near the known schedule. So if its result is not proven to be the best, a second search
    begins anew, each has half of the time, and the better result is kept. ``counted``: the seconds are
    measured by the work done, as on a computer that does nothing else; then the same problem gives the same
    schedule."""
    limit, found = seconds * (1 - TIDY), None
    windowed = any(lag.within_s is not None for task in problem.tasks for lag in task.lags)
    if hint:
        limit /= 1 + windowed
        found = _search(problem, limit, hint, counted=counted)
    if not hint or (windowed and (found is None or not found.proven)):
        anew = _search(problem, limit, {}, counted=counted)
        if found is None or (anew is not None and anew.cost < found.cost):
            found = anew
    if found is None:
        return None
    best = _search(problem, seconds * TIDY, dict(enumerate(found.starts_s)), counted=counted, tidy=True)
    if best is None:
        return found
    return replace(found, starts_s=best.starts_s, makespan_s=best.makespan_s)


def _search(
    problem: SchedulingProblem,
    limit: float,
    hint: Mapping[int, float],
    *,
    counted: bool,
    may_miss: bool = False,
    tidy: bool = False,
) -> Schedule | None:
    """One search that begins at ``hint``, if that is not empty. ``tidy``: each run's end counts too, their
    mean as much as the end of all, or less."""
    from ortools.sat.python import cp_model

    tasks = problem.tasks
    # The beginning of a booking may be at any time: then the clock has smaller steps.
    booked = [BOOKED_UNIT_S] if any(task.shut for task in tasks) else []
    set_up = [
        cost for each in problem.setups for row in (each.first_s, *each.change_s) for cost in row if cost
    ]
    unit = _unit_of([*(task.duration_s for task in tasks), *booked, *set_up])
    length = [max(1, math.ceil(task.duration_s / unit - 1e-9)) for task in tasks]
    waits = [lag.wait_s for task in tasks for lag in task.lags]
    shut_s = max((ends for task in tasks for _, ends in task.shut), default=0.0)
    changes_s = sum(
        max(max(row) for row in (each.first_s, *each.change_s)) * len(each.tasks) for each in problem.setups
    )
    horizon = sum(length) + math.ceil((sum(waits) + shut_s + changes_s) / unit) + 1
    model = cp_model.CpModel()
    begin = [model.new_int_var(0, 0 if task.runs else horizon, f"s{n}") for n, task in enumerate(tasks)]
    end: list[cp_model.LinearExprT] = [start + time for start, time in zip(begin, length, strict=True)]
    changes: dict[int, cp_model.IntVar] = {}
    for costs in problem.setups:
        changes.update(_add_setups(model, costs, begin, length, unit, hint))
    for number in changes:
        end[number] = model.new_int_var(0, 2 * horizon, f"e{number}")
    whole = model.new_int_var(0, 2 * horizon, "makespan")
    late: list[cp_model.IntVar] = []
    keeps_all = bool(hint) and not may_miss and not _misses_any(hint, tasks)
    using: dict[str, list[cp_model.IntervalVar]] = {}
    for number, task in enumerate(tasks):
        model.add(whole >= end[number])
        if number in hint:
            model.add_hint(begin[number], round(hint[number] / unit))
        takes = length[number] + changes[number] if number in changes else length[number]
        interval = model.new_interval_var(begin[number], takes, end[number], f"i{number}")
        for name in task.takes:
            using.setdefault(name, []).append(interval)
        if task.shut:
            model.add_no_overlap([interval, *_merge_closed(model, task.shut, unit)])
        for before in task.after:
            model.add(begin[number] >= end[before])
        for lag in task.lags:
            anchor = end[lag.anchor] if lag.anchor is not None else -math.floor(lag.ago_s / unit)
            model.add(begin[number] >= anchor + math.ceil(lag.wait_s / unit))
            if lag.within_s is not None and keeps_all:
                model.add(begin[number] <= anchor + math.floor(lag.within_s / unit))
            elif lag.within_s is not None:
                missed = model.new_bool_var(f"late{number}")
                late.append(missed)
                latest = anchor + math.floor(lag.within_s / unit)
                if number in hint:
                    model.add_hint(missed, _is_late(hint, number, lag, tasks))
                model.add(begin[number] <= latest).only_enforce_if(~missed)
    for intervals in using.values():
        model.add_no_overlap(intervals)
    standing: dict[str, list[cp_model.IntervalVar]] = {}
    stood: dict[str, list[tuple[int | None, int | None]]] = {}
    known: list[list[tuple[int | None, int | None]]] = []
    for number, stay in enumerate(problem.stays):
        first = begin[stay.first] if stay.first is not None else 0
        until = end[stay.last] if stay.last is not None else whole
        size = model.new_int_var(0, 2 * horizon, f"stay{number}")
        interval = model.new_interval_var(first, size, until, f"at{number}")
        standing.setdefault(stay.place, []).append(interval)
        stood.setdefault(stay.place, []).append((stay.first, stay.last))
    for place, intervals in standing.items():
        room = problem.room[place]
        if room == 1 and stood[place] in known:
            continue  # a deck with one place
        if room == 1:
            known.append(stood[place])
            model.add_no_overlap(intervals)
        elif len(intervals) > room:
            model.add_cumulative(intervals, [1] * len(intervals), max(room, 0))
    for one, other in problem.like:
        model.add(begin[one] <= begin[other])
    _limit_overtaking(model, [begin[first] for first in problem.line], problem.overtaken)
    over: list[cp_model.IntVar] = []
    for number, last_tasks in enumerate(problem.ends):
        over.append(model.new_int_var(0, 2 * horizon, f"end{number}"))
        for last in last_tasks:
            model.add(over[-1] >= end[last])
    # Further unknown runs of an experiment follow: an early end of the present one is better.
    goes_on = sum(last for last, more in zip(over, problem.more, strict=True) if more)
    first = sum(rank * last for last, rank in zip(over, problem.ranks, strict=False) if rank)
    overdue = _add_overdue(model, over, problem.due_s, unit, horizon)
    own_overdue = _add_overdue(model, over, problem.own_due_s, unit, horizon)
    cost = (
        whole
        + GOES_ON * goes_on
        + FIRST * (first + sum(overdue))
        + sum(own_overdue)
        + 4 * horizon * sum(late)
    )
    model.minimize(problem.end_weight * len(over) * cost + sum(over) if tidy else cost)
    solver = cp_model.CpSolver()
    solver.parameters.num_workers = 2
    solver.parameters.interleave_search = counted
    if counted:
        solver.parameters.max_deterministic_time = limit
    else:
        solver.parameters.max_time_in_seconds = limit
    status = solver.solve(model)
    if status == cp_model.INFEASIBLE and keeps_all:  # times are rounded: a window that was just kept is not
        return _search(problem, limit, hint, counted=counted, may_miss=True, tidy=tidy)
    if status not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
        return None
    return Schedule(
        tuple(solver.value(start) * unit for start in begin),
        max(map(solver.value, end), default=0) * unit,
        status == cp_model.OPTIMAL,
        solver.objective_value,
    )


def _add_setups(
    model: cp_model.CpModel,
    costs: SetupCosts,
    begin: Sequence[cp_model.IntVar],
    length: Sequence[int],
    unit: float,
    hint: Mapping[int, float],
) -> dict[int, cp_model.IntVar]:
    """The additional time of each of these tasks for the set-up of its module: the tasks are carried out one
    after the other, and the time of a set-up depends on the task before."""
    found: dict[int, cp_model.IntVar] = {}
    # Node 0 stands for the state before the first task and after the last one; the tasks follow it.
    arcs: list[tuple[int, int, cp_model.IntVar]] = []
    known = sorted((hint[number], number) for number in costs.tasks if number in hint)
    follows = dict(
        zip([None, *(number for _, number in known)], (number for _, number in known), strict=False)
    )
    for column, number in enumerate(costs.tasks):
        cost = [math.ceil(row[column] / unit - 1e-9) for row in (costs.first_s, *costs.change_s)]
        found[number] = model.new_int_var(0, max(cost), f"change{number}")
        arcs.append((column + 1, 0, model.new_bool_var(f"last{number}")))
        for before in (None, *costs.tasks):
            if before == number:
                continue
            row = 0 if before is None else costs.tasks.index(before) + 1
            is_next = model.new_bool_var(f"next{before}/{number}")
            arcs.append((row, column + 1, is_next))
            model.add(found[number] == cost[row]).only_enforce_if(is_next)
            if known:
                model.add_hint(is_next, follows.get(before) == number)
            if before is not None:
                model.add(begin[number] >= begin[before] + length[before]).only_enforce_if(is_next)
    model.add_circuit(arcs)
    return found


def _add_overdue(
    model: cp_model.CpModel,
    over: Sequence[cp_model.IntVar],
    due_s: Sequence[float | None],
    unit: float,
    horizon: int,
) -> list[cp_model.IntVar]:
    """How long after its due time each run ends, for runs with a due time."""
    found: list[cp_model.IntVar] = []
    for last, due in zip(over, due_s, strict=False):
        if due is not None:
            found.append(model.new_int_var(0, 4 * horizon, ""))
            model.add(found[-1] >= last - max(-horizon, math.floor(due / unit)))
    return found


def _limit_overtaking(
    model: cp_model.CpModel, line: Sequence[cp_model.IntVar], overtaken: Sequence[int]
) -> None:
    """No run may start late if more later ones went before it than the lab allows: the lab would refuse the
    order. ``overtaken``: how many went before each run already."""
    for number, elder in enumerate(line):
        most = max(0, PATIENCE - (overtaken[number] if overtaken else 0))
        if len(line) - number <= most:
            continue
        before: list[cp_model.IntVar] = []
        for younger in line[number + 1 :]:
            before.append(model.new_bool_var(f"before{number}/{len(before)}"))
            model.add(elder <= younger).only_enforce_if(~before[-1])
        model.add(sum(before) <= most)


def _misses_any(hint: Mapping[int, float], tasks: Sequence[Task]) -> bool:
    """Whether in a schedule that is known a window is missed, or a task that has one is not in it."""
    return any(
        number not in hint or _is_late(hint, number, lag, tasks)
        for number, task in enumerate(tasks)
        for lag in task.lags
        if lag.within_s is not None
    )


def _is_late(hint: Mapping[int, float], number: int, lag: TimeLag, tasks: Sequence[Task]) -> bool:
    """Whether, in a known schedule, a task starts too late after the end of another one."""
    if lag.within_s is None or (lag.anchor is not None and lag.anchor not in hint):
        return False
    anchor_s = -lag.ago_s if lag.anchor is None else hint[lag.anchor] + tasks[lag.anchor].duration_s
    return hint[number] > anchor_s + lag.within_s


def _merge_closed(
    model: cp_model.CpModel, times: Sequence[tuple[float, float]], unit: float
) -> list[cp_model.IntervalVar]:
    """Closed times of a resource; overlapping ones are merged."""
    found: list[list[int]] = []
    for begins, ends in sorted((math.floor(b / unit), math.ceil(e / unit)) for b, e in times):
        if found and begins <= found[-1][1]:
            found[-1][1] = max(found[-1][1], ends)
        else:
            found.append([begins, ends])
    return [model.new_fixed_size_interval_var(b, e - b, f"shut{n}") for n, (b, e) in enumerate(found)]


def _unit_of(durations: list[float]) -> float:
    """The time of one step of the clock: the largest of which all durations are multiples, or one second."""
    whole = [round(seconds) for seconds in durations if seconds >= 1]
    exact = all(abs(seconds - round(seconds)) < 1e-6 for seconds in durations)
    return float(math.gcd(*whole)) if exact and whole else 1.0
