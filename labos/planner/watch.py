"""When a workcell is worth a new look: after something that changes what is to be done, and not too often."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

import msgspec

from labos.core.decide.suggestions import SuggestOrder
from labos.core.ids import RunId
from labos.core.rules import lab_ns
from labos.core.runs import RunState, find_holds
from labos.core.state import LabState
from labos.planner.problem import MOST_WAITING
from labos.planning.forecast import is_pending
from labos.planning.suggested import GRACE_S

DRIFT_S = GRACE_S / 2
"""A step that has not started so long (lab seconds) after its time: things go otherwise than was planned."""

MOST_DOUBLINGS = 7
"""While the same runs are there, each further look waits twice as long as the one before, up to about an
hour: what stands still over night (a module that is down, a question) is not suggested again and again."""


class _Seen(msgspec.Struct):
    runs: tuple[tuple[RunId, bool], ...]
    order: SuggestOrder | None
    looked_at: int
    has_found: bool
    repeated: int = 0


class CellWatch:
    """What each workcell looked like when an order was looked for last."""

    def __init__(self) -> None:
        self._seen: dict[str, _Seen] = {}

    def is_due(self, state: LabState, cell: str, waiting: Iterable[RunState], now: int) -> bool:
        """Whether runs have come or gone since, are not where they should be, or nothing was found so far."""
        seen = self._seen.get(cell)
        if seen is None or seen.runs != _runs(state, cell, waiting):
            return True
        patience = lab_ns(state, DRIFT_S * 2**seen.repeated)
        if not seen.has_found and seen.looked_at + patience < now:
            return True  # on a busy computer, a search may end before it has found anything
        return seen.order is not None and any(
            one.start + patience < now and _is_open(state, one.run, one.step) for one in seen.order.steps
        )

    def note(
        self, state: LabState, cell: str, waiting: Iterable[RunState], order: SuggestOrder | None, now: int
    ) -> None:
        """An order was looked for; None: what was suggested before still counts."""
        before, runs = self._seen.get(cell), _runs(state, cell, waiting)
        repeated = 0
        if before is not None and before.runs == runs:
            repeated = min(before.repeated + 1, MOST_DOUBLINGS)
        known = before.order if order is None and before is not None else order
        self._seen[cell] = _Seen(runs, known, now, order is not None, repeated)


def list_waiting(state: LabState, cell: str) -> list[RunState]:
    """The runs that wait to be let into a workcell, in about the order in which they will be."""
    found = [run for run in state.runs.queued.values() if state.runs.plan_of(run).workcell == cell]
    return sorted(found, key=lambda run: (-run.priority, run.position))


def _runs(state: LabState, cell: str, waiting: Iterable[RunState]) -> tuple[tuple[RunId, bool], ...]:
    runs = [*state.runs.inside(cell), *islice(waiting, MOST_WAITING)]
    return tuple((run.id, bool(find_holds(run))) for run in runs)


def _is_open(state: LabState, name: RunId, step: int) -> bool:
    run = state.runs.get(name)
    return run is not None and is_pending(run, step) and not find_holds(run)
