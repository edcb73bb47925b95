"""Searches for an order of runs with windows, with more tries than the kernel has time for.

The lab has an order of its own for such runs (``window_order``), and searches for a better one after each
step, but with few tries. If a step has taken longer than planned, the known order may have become much worse,
and a better one is far from it. So the planner rates its order after each step. If the order has become
worse, the planner makes a long search.

It suggests only an order of runs, and no times for their steps. The lab's own search begins with this order,
and goes on from there. So the lab keeps correcting all times, and an order that is no better than its own
changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import islice

import msgspec
from msgspec.structs import replace

from labos.core.decide.suggestions import SuggestOrder
from labos.core.ids import RunId
from labos.core.rules import convert_lab_s
from labos.core.runs import RunState, find_holds
from labos.core.state import LabState
from labos.core.suggestions import OrderSuggested
from labos.planning.waiting import PATIENCE
from labos.planning.window_order import MOST_WAITING, WindowOrders

LEAST_DELAY = 0.005
"""A new search is made if the end of all runs is put off by more than this part of the time until then."""

STAYS_GOOD_S = 3600.0
"""A suggested line is valid for so long (lab seconds). Times of steps are valid for so long after the last
one."""


class _Searched(msgspec.Struct, frozen=True):
    """The runs of the last search, and the rating of the order that it found (``WindowOrders.find_best``)."""

    runs: frozenset[RunId]
    rating: tuple[int, int]


class WindowSearch:
    """The planner's orders of runs with windows. ``tries`` is the number of orders that a search tries. As in
    the lab, steps take their usual times in it: the lab compares the order with its own one."""

    def __init__(self, name: str, tries: int) -> None:
        self._name, self._tries = name, tries
        self._orders = WindowOrders(PATIENCE)
        self._searched: dict[str, _Searched] = {}

    def is_due(
        self,
        state: LabState,
        cell: str,
        waiting: Iterable[RunState],
        overtakings: Callable[[RunId], float],
        now: int,
    ) -> bool:
        """Whether a new search is worthwhile: there are new runs, or the known order has become worse. False
        if there was no search yet, or if the last one found no order."""
        last = self._searched.get(cell)
        if last is None:
            return False
        runs = _list_runs(state, cell, waiting)
        if not {run.id for run in runs} <= last.runs:
            return True
        if self._orders.search_longer(state, cell, runs, overtakings, now, 0) is None:
            return True
        _, (out, end) = self._orders.find_best(cell)
        return out > last.rating[0] or end > last.rating[1] + LEAST_DELAY * (end - now)

    def search(
        self,
        state: LabState,
        cell: str,
        waiting: Iterable[RunState],
        overtakings: Callable[[RunId], float],
        now: int,
    ) -> OrderSuggested | None:
        """The best order that is found for the runs of a workcell, with its line and its steps. None if the
        lab has no order of its own for such runs."""
        runs = _list_runs(state, cell, waiting)
        found = self._orders.search_longer(state, cell, runs, overtakings, now, self._tries)
        if found is None:
            self._searched.pop(cell, None)
            return None
        line, rating = self._orders.find_best(cell)
        self._searched[cell] = _Searched(frozenset(run.id for run in runs), rating)
        return replace(found, line=line)

    def suggest_line(self, state: LabState, found: OrderSuggested, now: int) -> SuggestOrder | None:
        """The suggestion of the line of an order; None if the lab knows this line already."""
        present = state.suggestions.find_line(found.workcell, now)
        if found.line == tuple(run for run in present if state.runs.get(run) is not None):
            return None
        until = now + convert_lab_s(state, STAYS_GOOD_S)
        return SuggestOrder(found.workcell, self._name, until, (), state.position, found.line)

    def suggest_steps(self, state: LabState, found: OrderSuggested) -> SuggestOrder:
        """The suggestion of the steps of an order, each at its time."""
        until = found.until + convert_lab_s(state, STAYS_GOOD_S)
        return SuggestOrder(found.workcell, self._name, until, found.steps, state.position)


def _list_runs(state: LabState, cell: str, waiting: Iterable[RunState]) -> list[RunState]:
    """The runs of which the lab itself would find an order now."""
    ahead = (run for run in waiting if not find_holds(run))
    return [*state.runs.list_inside(cell), *islice(ahead, MOST_WAITING)]
