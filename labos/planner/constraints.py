"""A scheduling problem as variables and constraints of CP-SAT (OR-tools, the extra ``plan``).

Times in the model are whole numbers of *units*. The unit is as long as the durations allow, because a search
with few different times is faster.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from ortools.sat.python import cp_model

from labos.planner.measure import GOES_ON
from labos.planner.problem import SchedulingProblem, SetupCosts, Task, TimeLag
from labos.planning.waiting import PATIENCE

WEIGHT_OF_RANK = 8
"""The weight of a run's end for each class before which the run goes, and of each second after its campaign's
deadline."""

BOOKED_UNIT_S = 10.0
"""If a module is booked, the unit is at most so long (lab seconds): a booking may begin at any time."""


class ScheduleModel:
    """The model (``cp``) of a problem. ``begin`` and ``end`` are the start and the end of each task in units;
    ``unit`` is the length of a unit (lab seconds). ``hint`` are the starts (lab seconds) in a known schedule,
    by task. With ``keeps_all``, no window may be missed. Otherwise a missed window costs more than all else.
    """

    def __init__(self, problem: SchedulingProblem, hint: Mapping[int, float], *, keeps_all: bool) -> None:
        self.cp = cp_model.CpModel()
        self.unit = _choose_unit(problem)
        self._problem, self._hint, self._keeps_all = problem, hint, keeps_all
        self._length = [max(1, self._round_up(task.duration_s)) for task in problem.tasks]
        self._horizon = sum(self._length) + math.ceil(_sum_pauses(problem) / self.unit) + 1
        self.begin = [
            self.cp.new_int_var(0, 0 if task.runs else self._horizon, f"s{number}")
            for number, task in enumerate(problem.tasks)
        ]
        self.end: list[cp_model.LinearExprT] = [
            start + time for start, time in zip(self.begin, self._length, strict=True)
        ]
        self._changes: dict[int, cp_model.IntVar] = {}
        for costs in problem.setups:
            self._add_setups(costs)
        for number in self._changes:
            self.end[number] = self.cp.new_int_var(0, 2 * self._horizon, f"e{number}")
        self._whole = self.cp.new_int_var(0, 2 * self._horizon, "makespan")
        self._missed: list[cp_model.IntVar] = []
        self._add_tasks()
        self._add_stays()
        for one, other in problem.like:
            self.cp.add(self.begin[one] <= self.begin[other])
        self._limit_overtaking()

    def minimize_ends(self, *, tidy: bool) -> None:
        """Make the end of all as early as possible, with the weights of ranks, deadlines and windows.
        ``tidy``: the mean of all ends counts too."""
        problem = self._problem
        ends: list[cp_model.IntVar] = []
        for number, last_tasks in enumerate(problem.ends):
            ends.append(self.cp.new_int_var(0, 2 * self._horizon, f"end{number}"))
            for last in last_tasks:
                self.cp.add(ends[-1] >= self.end[last])
        # Further unknown runs of an experiment follow: an early end of the present one is better.
        goes_on = sum(end for end, more in zip(ends, problem.more, strict=True) if more)
        first = sum(rank * end for end, rank in zip(ends, problem.ranks, strict=False) if rank)
        overdue = self._add_overdue(ends, problem.due_s)
        own_overdue = self._add_overdue(ends, problem.own_due_s)
        cost = (
            self._whole
            + GOES_ON * goes_on
            + WEIGHT_OF_RANK * (first + sum(overdue))
            + sum(own_overdue)
            + 4 * self._horizon * sum(self._missed)
        )
        self.cp.minimize(problem.end_weight * len(ends) * cost + sum(ends) if tidy else cost)

    def _round_up(self, seconds: float) -> int:
        return math.ceil(seconds / self.unit - 1e-9)

    def _add_tasks(self) -> None:
        """Each task comes after those before it, and shares its resources and its module's open times with no
        other one."""
        using: dict[str, list[cp_model.IntervalVar]] = {}
        for number, task in enumerate(self._problem.tasks):
            begin, end = self.begin[number], self.end[number]
            self.cp.add(self._whole >= end)
            if number in self._hint:
                self.cp.add_hint(begin, round(self._hint[number] / self.unit))
            change = self._changes.get(number)
            takes = self._length[number] if change is None else self._length[number] + change
            interval = self.cp.new_interval_var(begin, takes, end, f"i{number}")
            for name in task.takes:
                using.setdefault(name, []).append(interval)
            if task.shut:
                self.cp.add_no_overlap([interval, *self._list_closed_times(task)])
            for before in task.after:
                self.cp.add(begin >= self.end[before])
            for lag in task.lags:
                self._add_lag(number, lag)
        for intervals in using.values():
            self.cp.add_no_overlap(intervals)

    def _add_lag(self, number: int, lag: TimeLag) -> None:
        """A task starts in its window. A missed window costs, or is impossible with ``keeps_all``."""
        begin = self.begin[number]
        anchor = self.end[lag.anchor] if lag.anchor is not None else -math.floor(lag.ago_s / self.unit)
        self.cp.add(begin >= anchor + math.ceil(lag.wait_s / self.unit))
        if lag.within_s is None:
            return
        latest = anchor + math.floor(lag.within_s / self.unit)
        if self._keeps_all:
            self.cp.add(begin <= latest)
            return
        missed = self.cp.new_bool_var(f"late{number}")
        self._missed.append(missed)
        if number in self._hint:
            self.cp.add_hint(missed, _is_late(self._hint, number, lag, self._problem.tasks))
        self.cp.add(begin <= latest).only_enforce_if(~missed)

    def _add_stays(self) -> None:
        """No place holds more labware than it has room for."""
        standing: dict[str, list[cp_model.IntervalVar]] = {}
        stood: dict[str, list[tuple[int | None, int | None]]] = {}
        for number, stay in enumerate(self._problem.stays):
            first = self.begin[stay.first] if stay.first is not None else 0
            until = self.end[stay.last] if stay.last is not None else self._whole
            size = self.cp.new_int_var(0, 2 * self._horizon, f"stay{number}")
            interval = self.cp.new_interval_var(first, size, until, f"at{number}")
            standing.setdefault(stay.place, []).append(interval)
            stood.setdefault(stay.place, []).append((stay.first, stay.last))
        known: list[list[tuple[int | None, int | None]]] = []
        for place, intervals in standing.items():
            room = self._problem.room[place]
            if room == 1 and stood[place] in known:
                continue  # a deck with one place
            if room == 1:
                known.append(stood[place])
                self.cp.add_no_overlap(intervals)
            elif len(intervals) > room:
                self.cp.add_cumulative(intervals, [1] * len(intervals), max(room, 0))

    def _add_setups(self, costs: SetupCosts) -> None:
        """The additional time of each of these tasks for the set-up of its module: the tasks are carried out
        one after the other, and the time of a set-up depends on the task before."""
        # Node 0 stands for the state before the first task and after the last one; the tasks follow it.
        arcs: list[tuple[int, int, cp_model.IntVar]] = []
        known = [number for _, number in sorted((self._hint[n], n) for n in costs.tasks if n in self._hint)]
        follows = dict(zip([None, *known], known, strict=False))
        for column, number in enumerate(costs.tasks):
            cost = [self._round_up(row[column]) for row in (costs.first_s, *costs.change_s)]
            change = self._changes[number] = self.cp.new_int_var(0, max(cost), f"change{number}")
            arcs.append((column + 1, 0, self.cp.new_bool_var(f"last{number}")))
            for before in (None, *costs.tasks):
                if before == number:
                    continue
                row = 0 if before is None else costs.tasks.index(before) + 1
                is_next = self.cp.new_bool_var(f"next{before}/{number}")
                arcs.append((row, column + 1, is_next))
                self.cp.add(change == cost[row]).only_enforce_if(is_next)
                if known:
                    self.cp.add_hint(is_next, follows.get(before) == number)
                if before is not None:
                    ended = self.begin[before] + self._length[before]
                    self.cp.add(self.begin[number] >= ended).only_enforce_if(is_next)
        self.cp.add_circuit(arcs)

    def _add_overdue(
        self, ends: Sequence[cp_model.IntVar], due_s: Sequence[float | None]
    ) -> list[cp_model.IntVar]:
        """How long after its due time each run ends, for runs with a due time."""
        found: list[cp_model.IntVar] = []
        for end, due in zip(ends, due_s, strict=False):
            if due is not None:
                found.append(self.cp.new_int_var(0, 4 * self._horizon, ""))
                self.cp.add(found[-1] >= end - max(-self._horizon, math.floor(due / self.unit)))
        return found

    def _limit_overtaking(self) -> None:
        """No run may start late if more later ones went before it than the lab allows: the lab would refuse
        the order."""
        line = [self.begin[first] for first in self._problem.line]
        overtaken = self._problem.overtaken
        for number, elder in enumerate(line):
            most = max(0, PATIENCE - (overtaken[number] if overtaken else 0))
            if len(line) - number <= most:
                continue
            before: list[cp_model.IntVar] = []
            for younger in line[number + 1 :]:
                before.append(self.cp.new_bool_var(f"before{number}/{len(before)}"))
                self.cp.add(elder <= younger).only_enforce_if(~before[-1])
            self.cp.add(sum(before) <= most)

    def _list_closed_times(self, task: Task) -> list[cp_model.IntervalVar]:
        """The times in which a task's module is booked for others; overlapping ones are merged."""
        times = sorted((math.floor(b / self.unit), math.ceil(e / self.unit)) for b, e in task.shut)
        found: list[list[int]] = []
        for begins, ends in times:
            if found and begins <= found[-1][1]:
                found[-1][1] = max(found[-1][1], ends)
            else:
                found.append([begins, ends])
        return [self.cp.new_fixed_size_interval_var(b, e - b, f"shut{n}") for n, (b, e) in enumerate(found)]


def misses_window(hint: Mapping[int, float], tasks: Sequence[Task]) -> bool:
    """Whether a known schedule misses a window, or lacks a task that has one."""
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


def _sum_pauses(problem: SchedulingProblem) -> float:
    """So long (lab seconds) nothing may happen, at most: waits, closed times and set-ups."""
    waits_s = sum(lag.wait_s for task in problem.tasks for lag in task.lags)
    shut_s = max((ends for task in problem.tasks for _, ends in task.shut), default=0.0)
    changes_s = sum(
        max(max(row) for row in (each.first_s, *each.change_s)) * len(each.tasks) for each in problem.setups
    )
    return waits_s + shut_s + changes_s


def _choose_unit(problem: SchedulingProblem) -> float:
    """The length of a unit (lab seconds): the longest of which all durations and set-up times are multiples,
    or one second."""
    booked = [BOOKED_UNIT_S] if any(task.shut for task in problem.tasks) else []
    setups = [row for each in problem.setups for row in (each.first_s, *each.change_s)]
    set_up = [cost for row in setups for cost in row if cost]
    times = [*(task.duration_s for task in problem.tasks), *booked, *set_up]
    whole = [round(seconds) for seconds in times if seconds >= 1]
    exact = all(abs(seconds - round(seconds)) < 1e-6 for seconds in times)
    return float(math.gcd(*whole)) if exact and whole else 1.0
