"""Decides when a new search for a workcell is worthwhile: after changes of the remaining work, and not too
often."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

import msgspec

from labos.core.decide.suggestions import SuggestOrder
from labos.core.ids import RunId
from labos.core.rules import convert_lab_s
from labos.core.runs import RunState, find_holds
from labos.core.state import LabState
from labos.planner.problem import MOST_WAITING
from labos.planning.forecast import is_pending
from labos.planning.suggested import GRACE_S

DRIFT_S = GRACE_S / 2
"""If a step has not started so long (lab seconds) after its planned time, the lab differs from the plan."""

MOST_DOUBLINGS = 7
"""While the runs stay the same, the pause before each further search is twice as long, up to about an hour:
if the lab stands still over night (a module is down, a question is open), no suggestion is repeated again and
again."""


MOST_UNSEEN = 10
"""So many runs that were too far behind to be planned may move up before a new search."""


class _Seen(msgspec.Struct):
    runs: dict[RunId, bool]
    position: int
    order: SuggestOrder | None
    looked_at: int
    has_found: bool
    repeated: int = 0
    in_vain: int = 0


class CellWatch:
    """The state of each workcell at its last search."""

    def __init__(self) -> None:
        self._seen: dict[str, _Seen] = {}

    def is_due(self, state: LabState, cell: str, waiting: Iterable[RunState], now: int) -> bool:
        """Whether there are new runs, runs have ended early or are not where the plan expected them, or
        nothing was found so far. While the lab follows the plan, there is no new search."""
        seen = self._seen.get(cell)
        if seen is None or _has_changed(state, seen, _list_runs(state, cell, waiting)):
            return True
        if not seen.has_found and seen.looked_at + convert_lab_s(state, DRIFT_S * 2**seen.in_vain) < now:
            return True  # on a busy computer, a search may end before it has found anything
        patience = convert_lab_s(state, DRIFT_S * 2**seen.repeated)
        steps = seen.order.steps if seen.order is not None else ()
        return any(
            state.runs.get(one.run) is None
            if one.start > now + patience
            else one.start + patience < now and _is_open(state, one.run, one.step)
            for one in steps
        )

    def note(
        self, state: LabState, cell: str, waiting: Iterable[RunState], order: SuggestOrder | None, now: int
    ) -> None:
        """Note a search; None: the previous suggestion is still valid."""
        before, runs = self._seen.get(cell), _list_runs(state, cell, waiting)
        repeated = in_vain = 0
        if before is not None and before.runs == runs:
            repeated = min(before.repeated + 1, MOST_DOUBLINGS)
        if before is not None and order is None and not _has_changed(state, before, runs):
            in_vain = min(before.in_vain + 1, MOST_DOUBLINGS)
        known = before.order if order is None and before is not None else order
        self._seen[cell] = _Seen(runs, state.position, known, now, order is not None, repeated, in_vain)


def list_waiting(state: LabState, cell: str) -> list[RunState]:
    """The runs that wait to start in a workcell, in about the order in which they will start."""
    found = [run for run in state.runs.queued.values() if state.runs.plan_of(run).workcell == cell]
    return sorted(found, key=lambda run: (-run.priority, run.position))


def _list_runs(state: LabState, cell: str, waiting: Iterable[RunState]) -> dict[RunId, bool]:
    """The runs that are planned, and whether each of them is prevented from starting."""
    runs = [*state.runs.list_inside(cell), *islice(waiting, MOST_WAITING)]
    return {run.id: bool(find_holds(run)) for run in runs}


def _has_changed(state: LabState, seen: _Seen, runs: dict[RunId, bool]) -> bool:
    """Whether runs were submitted since, have been blocked or unblocked, or many have moved up."""
    unseen = 0
    for name, is_held in runs.items():
        if name in seen.runs:
            if seen.runs[name] != is_held:
                return True
            continue
        run = state.runs.get(name)
        if run is not None and run.position > seen.position:
            return True
        unseen += 1
    return unseen >= MOST_UNSEEN


def _is_open(state: LabState, name: RunId, step: int) -> bool:
    run = state.runs.get(name)
    return run is not None and is_pending(run, step) and not find_holds(run)
