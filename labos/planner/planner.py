"""Suggests an order for each workcell in turn.

Where the lab has an order of its own because of windows, the planner suggests a better one to begin with
(``windows``). Otherwise, it suggests when each step starts, but only if a rehearsal of the lab ends better
with this order than without any order, and better than with the previous suggestion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

from msgspec.structs import replace

from labos.core.branches import sort_by_predecessors
from labos.core.decide.suggestions import SuggestOrder
from labos.core.ids import RunId
from labos.core.rules import convert_lab_s
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.core.suggestions import Suggested
from labos.planner.lengths import SPREAD
from labos.planner.overtakings import Overtakings
from labos.planner.problem import SchedulingProblem, add_next, choose_runs, problem_of
from labos.planner.rehearsal import DRAWN, OrderRehearsal, Way
from labos.planner.solve import Schedule, solve
from labos.planner.windows import STAYS_GOOD_S, WindowSearch
from labos.planning.suggested import GRACE_S

Solver = Callable[[SchedulingProblem, float, dict[int, float]], Schedule | None]

MOST_TRIES = 15_000
"""The most orders of runs with windows that one search tries; fewer if a search has less than a second. They
take about five seconds of processor time for 16 runs."""

LEAST_OUTSIDE_S = 600.0
"""A run waits outside if it would otherwise stand where it comes in for so long (lab seconds), in the way of
all that come later. For a shorter time, few come."""


class Planner:
    """``seconds`` is how long each search for an order may take, ``level`` the quantile of durations for
    planning, between 0 and 1. ``exact``: durations are known exactly, so no rehearsal draws other ones.
    The end of all counts ``end_weight`` times as much as the mean of all ends: more than once where no
    further runs are expected. ``searches``: the lab looks for an order of its own where none is
    suggested."""

    def __init__(
        self,
        name: str = "planner",
        seconds: float = 5.0,
        solver: Solver = solve,
        level: float = 0.5,
        *,
        exact: bool = False,
        end_weight: int = 1,
        searches: bool = False,
    ) -> None:
        self._searches = searches
        self.name, self.seconds, self.level, self.exact = name, seconds, level, exact
        self.end_weight = end_weight
        self._solve = solver
        self._overtaken: dict[str, Overtakings] = {}
        self._windows = WindowSearch(name, int(MOST_TRIES * min(1.0, seconds)))

    def is_due(self, state: LabState, cell: str, waiting: Iterable[RunState], now: int) -> bool:
        """Whether the order of runs with windows that was suggested last has become worse, so that a new
        search is worthwhile. This takes some ten milliseconds, so ask often."""
        waiting = list(waiting)
        counts = self._overtaken.setdefault(cell, Overtakings()).count(state, cell, waiting)
        return self._windows.is_due(state, cell, waiting, counts.__getitem__, now)

    def suggest(
        self, state: LabState, cell: str, waiting: Iterable[RunState], now: int
    ) -> SuggestOrder | None:
        """The suggested order for a workcell; None if there is nothing to order, or if the present order is
        as good. An order without steps and without a line withdraws the previous suggestion. ``waiting`` are
        the waiting runs, in the order in which they would start."""
        waiting = list(waiting)
        runs = choose_runs(state, cell, waiting)
        problem = replace(problem_of(state, runs, now, self.level), end_weight=self.end_weight)
        counts = self._overtaken.setdefault(cell, Overtakings()).count(state, cell, waiting)
        overtaken = tuple(counts[problem.tasks[first].run] for first in problem.line)
        problem = replace(problem, overtaken=overtaken)
        if _is_one_line(problem):
            return None
        windowed = self._windows.search(state, cell, waiting, counts.__getitem__, now)
        begin = None
        if windowed is not None and not self.exact:
            begin = self._windows.suggest_line(state, windowed, now)
            if not _has_ranks(problem):
                return begin  # the lab itself compares it with its own order
        rehearsed, drawn = add_next(runs, waiting), 0 if self.exact else DRAWN
        rehearsal = OrderRehearsal(
            state,
            cell,
            now,
            self.level,
            rehearsed,
            drawn=drawn,
            end_weight=self.end_weight,
            searches=self._searches,
            overtaken=counts,
        )
        best = without = rehearsal.go(None)
        present = rehearsal.order
        if present is not None and not all(step.outside for step in present.steps):
            before = rehearsal.go(present)
            best = without if rehearsal.is_better(without, before) else before
        if rehearsal.may_be_better(_list_ends(state, problem, now, _list_earliest_starts(problem)), best):
            better: SuggestOrder | None = None
            if windowed is not None and self.exact and len(rehearsed) == len(runs):
                # While more runs follow, the lab's own order has to go on.
                begin = self._windows.suggest_steps(state, windowed)
            if begin is not None and rehearsal.is_better(way := rehearsal.go(begin), best):
                better, best = begin, way
            found = self._search(state, cell, problem, now, rehearsal, best)
            if found is not None and rehearsal.is_better(rehearsal.go(found), best):
                better = found
            if better is not None:
                return better
        if best is not without:
            return None
        outside = () if self.exact else tuple(_list_outside(state, problem, now, rehearsal.list_starts(best)))
        if outside and present is not None and _are_alike(state, present.steps, outside):
            return None
        if outside:
            waits = SuggestOrder(cell, self.name, outside[-1].start + 1, outside, state.position)
            if rehearsal.is_as_good(rehearsal.go(waits), without):
                return waits
        return SuggestOrder(cell, self.name, now, (), state.position) if present is not None else None

    def _search(
        self,
        state: LabState,
        cell: str,
        problem: SchedulingProblem,
        now: int,
        rehearsal: OrderRehearsal,
        best: Way,
    ) -> SuggestOrder | None:
        """The order that is found, if it is better in the model of the search. The search begins with the
        best way so far."""
        pace, known = state.lab.pace, rehearsal.list_starts(best)
        hint = {
            number: max(0.0, (known[task.run, task.step] - now) / 1e9 * pace)
            for number, task in enumerate(problem.tasks)
            if (task.run, task.step) in known
        }
        found = self._solve(problem, self.seconds, hint)
        if found is None:
            return None
        if not rehearsal.may_be_better(_list_ends(state, problem, now, found.starts_s), best):
            return None
        steps = tuple(
            Suggested(task.run, task.step, now + convert_lab_s(state, start))
            for task, start in zip(problem.tasks, found.starts_s, strict=True)
            if not task.runs
        )
        if not steps:
            return None
        until = max(step.start for step in steps) + convert_lab_s(state, STAYS_GOOD_S)
        ordered = tuple(sorted(steps, key=lambda step: step.start))
        return SuggestOrder(cell, self.name, until, ordered, state.position)


def _has_ranks(problem: SchedulingProblem) -> bool:
    """Whether some runs go before others, or have a time at which they are due."""
    due = (*problem.due_s, *problem.own_due_s)
    return len(set(problem.ranks)) > 1 or any(at is not None for at in due)


def _list_outside(
    state: LabState, problem: SchedulingProblem, now: int, known: Mapping[tuple[RunId, int], int]
) -> list[Suggested]:
    """The starts of waiting runs that would stand where they came in before they can go on (``known`` starts,
    UTC ns): each as late as possible, less what the times until then may vary by."""
    found: list[Suggested] = []
    for first in problem.line:
        task, *others = problem.tasks[first : first + 2]
        second = others[0] if others and others[0].run == task.run else None
        if second is None or second.after != (first,) or second.lags:
            continue
        at, goes_on = (known.get((each.run, each.step)) for each in (task, second))
        if at is None or goes_on is None:
            continue
        latest = goes_on - convert_lab_s(state, task.duration_s)
        start = latest - int(SPREAD * (latest - now))
        if start > at + convert_lab_s(state, LEAST_OUTSIDE_S):
            found.append(Suggested(task.run, task.step, start, outside=True))
    return sorted(found, key=lambda step: step.start)


def _are_alike(state: LabState, before: Sequence[Suggested], after: Sequence[Suggested]) -> bool:
    """Whether the same runs start at about the same times."""
    starts = {one.run: one.start for one in before}
    most = convert_lab_s(state, GRACE_S)
    return starts.keys() == {one.run for one in after} and all(
        abs(starts[one.run] - one.start) < most for one in after
    )


def _list_earliest_starts(problem: SchedulingProblem) -> list[float]:
    """When each task could start (lab seconds from now) if it waited for nothing but its own run."""
    starts = [0.0] * len(problem.tasks)
    for number in sort_by_predecessors({number: task.after for number, task in enumerate(problem.tasks)}):
        before = problem.tasks[number].after
        starts[number] = max((starts[n] + problem.tasks[n].duration_s for n in before), default=0.0)
    return starts


def _list_ends(
    state: LabState, problem: SchedulingProblem, now: int, starts_s: Sequence[float]
) -> dict[RunId, int]:
    """When each run ends (UTC ns) if its tasks start at these times (lab seconds from now)."""
    ends: dict[RunId, int] = {}
    for task, start in zip(problem.tasks, starts_s, strict=True):
        end = now + convert_lab_s(state, start + task.duration_s)
        ends[task.run] = max(ends.get(task.run, end), end)
    return ends


def _is_one_line(problem: SchedulingProblem) -> bool:
    """Whether there is nothing to order: one run, whose steps follow one another."""
    if len({task.run for task in problem.tasks}) > 1:
        return False
    return all(number - 1 in task.after for number, task in enumerate(problem.tasks) if number)
