"""Suggested orders that are followed exactly.

A suggested order is rehearsed once to its end, with every run that it names. If all windows are kept that
can be kept, each step may start at its suggested time while all goes as suggested. All goes as suggested if
each step has started at its time, and no step in flight is late. Then no further rehearsals are necessary.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import msgspec

from labos.core.ids import RunId
from labos.core.rules import convert_lab_s
from labos.core.runs import find_holds
from labos.core.state import LabState
from labos.core.suggestions import OrderSuggested
from labos.planning.forecast import find_setup_in_progress, find_start_alone, find_usual_time
from labos.planning.player import Step
from labos.planning.retiming import EXACT_S, list_avoidable_misses, rehearse
from labos.planning.scene import Scene
from labos.planning.suggested import bring_forward, find_order, find_suggested_times


class _Rehearsed(msgspec.Struct):
    """An order, its runs, and whether it keeps all windows that can be kept (None: not rehearsed yet). False
    also if none of its runs has windows."""

    order: OrderSuggested
    runs: frozenset[RunId]
    is_good: bool | None


class PunctualOrders:
    """The suggestion for each workcell, or else the lab's ``own`` order for windows; rehearsed once."""

    def __init__(self, own: Mapping[str, OrderSuggested] = MappingProxyType({})) -> None:
        self._own = own
        self._known: dict[str, _Rehearsed] = {}

    def find_starts(self, state: LabState, cell: str, now: int) -> dict[Step, int] | None:
        """When each pending step of an order starts (UTC ns), if the order keeps all windows that can be kept
        and all goes as suggested. None if not, if there is no order, or if none of its runs has windows."""
        if not state.suggestions.orders and not self._own:
            return None
        order = find_order(state, self._own, cell, now)
        if order is None:
            return None
        known = self._known.get(cell)
        if known is None or known.order is not order:
            runs = frozenset(one.run for one in order.steps)
            has_windows = any(state.runs.plans[run.plan].windowed for run in map(state.runs.get, runs) if run)
            known = self._known[cell] = _Rehearsed(order, runs, None if has_windows else False)
        if known.is_good is False:
            return None
        times = find_suggested_times(state, order, now)
        if not times or not _goes_as_suggested(state, cell, known.runs, times, now):
            return None
        starts = {(str(run), step): at for (run, step), at in times.items()}
        if known.is_good is None:
            known.is_good = _keeps_windows(state, cell, starts, now)
        return starts if known.is_good else None


def _goes_as_suggested(
    state: LabState, cell: str, runs: frozenset[RunId], times: dict[tuple[RunId, int], int], now: int
) -> bool:
    """Whether each step has started at its time, no step in flight is late, and no clock runs out before its
    step's time. All runs inside have to be in the order, and none of its runs may be paused, unapproved or
    ending."""
    slack = convert_lab_s(state, EXACT_S)
    late = now - slack
    if min(times.values()) < late or any(run.id not in runs for run in state.runs.list_inside(cell)):
        return False
    if any(
        times[who] > at + slack and times[who] > _find_start_alone(state, cell, *who, now) + slack
        for who, at in bring_forward(state, times, now).items()
    ):
        return False  # a step ended early, and the clock that it started runs out before
    if any(find_holds(run) or run.is_ending for run in map(state.runs.get, runs) if run is not None):
        return False
    for action in state.actions.list_in_cell(cell):
        acting = state.runs.active.get(action.run)
        if acting is None:
            return False
        takes = find_usual_time(state, state.runs.plan_of(acting).steps[action.step])
        if action.requested_at + takes + find_setup_in_progress(state, action) < late:
            return False
    return True


def _find_start_alone(state: LabState, cell: str, name: RunId, step: int, now: int) -> int:
    """When a step of a run inside would start if it waited for nothing else (UTC ns)."""
    ends = Scene(state, cell, now).list_ends().get(str(name), {})
    return find_start_alone(state, state.runs.active[name], step, ends, now)


def _keeps_windows(state: LabState, cell: str, starts: dict[Step, int], now: int) -> bool:
    """Whether every step of these runs starts at its time, and no window is missed that can be kept, in a
    rehearsal of them all. False also if a step that is left has no time."""
    rehearsed = rehearse(state, cell, starts, now)
    if rehearsed is None:
        return False
    result, ends = rehearsed
    slack = convert_lab_s(state, EXACT_S)
    is_punctual = all(at <= starts[who] + slack for who, at in result.starts.items())
    return is_punctual and not list_avoidable_misses(state, result, ends, now)
