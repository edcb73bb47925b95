"""Due dates of runs: which of a user's runs goes first."""

from __future__ import annotations

from labos.core.model import MAIN
from labos.core.runs import SETTLED, RunState
from labos.core.state import LabState
from labos.planning.forecast import find_earliest_start, find_usual_time

UNDATED = float("inf")
"""The rank of a run that is not due at any time: it goes after those that are."""


class DueDates:
    """Ranks runs by how little time they have to spare; ``forget`` what was worked out after each turn."""

    def __init__(self) -> None:
        self._left: dict[str, int] = {}

    def forget(self) -> None:
        """Lengths may have been learned, and clocks have gone on."""
        self._left.clear()

    def rank(self, state: LabState, run: RunState) -> float:
        """When a run has to go on at the latest so that it is over when it is due (UTC ns). The least goes
        first; that one may have passed."""
        if not run.due_at:
            return UNDATED
        if run.has_started:
            return run.due_at - find_time_left(state, run)
        left = self._left.get(run.plan)
        if left is None:
            left = self._left[run.plan] = find_time_left(state, run)
        return run.due_at - left


def find_time_left(state: LabState, run: RunState) -> int:
    """What is left of a run, if nothing is in its way (ns of wall time): the longest chain of its steps, with
    the waits between them."""
    plan, now = state.runs.plan_of(run), state.recorded_at
    ends: dict[int, int] = {}
    for index, step in enumerate(plan.steps):
        if step.part != MAIN or (run.has_started and run.steps[index].status in SETTLED):
            continue
        begins = max((ends.get(before, now) for before in step.after), default=now)
        ends[index] = max(begins, find_earliest_start(state, run, index, ends)) + find_usual_time(state, step)
    return max(ends.values(), default=now) - now


__all__ = ["UNDATED", "DueDates", "find_time_left"]
