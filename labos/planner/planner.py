"""Suggests an order for each workcell in turn.

An order is suggested only if a rehearsal of the lab ends better with it than without any order, and better
than with the previous suggestion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from msgspec.structs import replace

from labos.core.decide.suggestions import SuggestOrder
from labos.core.ids import RunId
from labos.core.rules import convert_lab_s
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.core.suggestions import Suggested
from labos.planner.problem import SchedulingProblem, choose_runs, problem_of
from labos.planner.rehearsal import DRAWN, OrderRehearsal
from labos.planner.solve import Schedule, solve

Solver = Callable[[SchedulingProblem, float, dict[int, float]], Schedule | None]

STAYS_GOOD_S = 3600.0
"""A suggestion is valid for at most so long after its last start (lab seconds)."""


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

    def suggest(
        self, state: LabState, cell: str, waiting: Iterable[RunState], now: int
    ) -> SuggestOrder | None:
        """The suggested order for a workcell; None if there is nothing to order, or if the present order is
        as good. An order without steps withdraws the previous suggestion. ``waiting`` are the waiting runs,
        in the order in which they would start."""
        runs = choose_runs(state, cell, waiting)
        problem = replace(problem_of(state, cell, runs, now, self.level), end_weight=self.end_weight)
        if _is_one_line(problem):
            return None
        drawn = 0 if self.exact else DRAWN
        rehearsal = OrderRehearsal(
            state,
            cell,
            now,
            self.level,
            runs,
            drawn=drawn,
            end_weight=self.end_weight,
            searches=self._searches,
        )
        best = without = rehearsal.go(None)
        if rehearsal.order is not None:
            before = rehearsal.go(rehearsal.order)
            best = without if rehearsal.is_better(without, before) else before
        found = self._search(state, cell, problem, now, rehearsal.list_starts(best))
        if found is not None and rehearsal.is_better(rehearsal.go(found), best):
            return found
        if rehearsal.order is None or best is not without:
            return None
        return SuggestOrder(cell, self.name, now, (), state.position)

    def _search(
        self,
        state: LabState,
        cell: str,
        problem: SchedulingProblem,
        now: int,
        known: dict[tuple[RunId, int], int],
    ) -> SuggestOrder | None:
        """The order that is found. The search begins with the order without a suggestion (``known`` starts,
        UTC ns)."""
        pace = state.lab.pace
        hint = {
            number: max(0.0, (known[task.run, task.step] - now) / 1e9 * pace)
            for number, task in enumerate(problem.tasks)
            if (task.run, task.step) in known
        }
        found = self._solve(problem, self.seconds, hint)
        if found is None:
            return None
        starts = {
            (task.run, task.step): now + convert_lab_s(state, start)
            for task, start in zip(problem.tasks, found.starts_s, strict=True)
        }
        steps = tuple(
            Suggested(task.run, task.step, starts[task.run, task.step])
            for task in problem.tasks
            if not task.runs
        )
        if not steps:
            return None
        until = max(step.start for step in steps) + convert_lab_s(state, STAYS_GOOD_S)
        ordered = tuple(sorted(steps, key=lambda step: step.start))
        return SuggestOrder(cell, self.name, until, ordered, state.position)


def _is_one_line(problem: SchedulingProblem) -> bool:
    """Whether there is nothing to order: one run, whose steps follow one another."""
    if len({task.run for task in problem.tasks}) > 1:
        return False
    return all(number - 1 in task.after for number, task in enumerate(problem.tasks) if number)
