"""Due dates of runs: which run of a user goes first."""

from __future__ import annotations

from labos.core.model import MAIN
from labos.core.runs import SETTLED, RunState
from labos.core.state import LabState
from labos.planning.forecast import find_earliest_start, find_usual_time

UNDATED = float("inf")
"""The rank of a run without a due date: it goes after runs with one."""


class DueDates:
    """Ranks runs by the time that they have to spare. Results count for one turn (``forget``)."""

    def __init__(self) -> None:
        self._left: dict[str, int] = {}

    def forget(self) -> None:
        """Forget all results: durations may have been learned, and time has passed."""
        self._left.clear()

    def rank(self, state: LabState, run: RunState) -> float:
        """The latest time at which a run has to continue, so that it ends by its due date (UTC ns; it may
        have passed). ``UNDATED`` if it has none. The least goes first."""
        if not run.due_at:
            return UNDATED
        if run.has_started:
            return run.due_at - find_time_left(state, run)
        left = self._left.get(run.plan)
        if left is None:
            left = self._left[run.plan] = find_time_left(state, run)
        return run.due_at - left


def find_time_left(state: LabState, run: RunState) -> int:
    """The time that a run still takes without any delay (ns of wall time): the longest chain of its main
    steps that have not ended, with the waits between them. A step in flight counts in full."""
    plan, now = state.runs.plan_of(run), state.recorded_at
    ends: dict[int, int] = {}
    for index, step in enumerate(plan.steps):
        if step.part != MAIN or (run.has_started and run.steps[index].status in SETTLED):
            continue
        begins = max((ends.get(before, now) for before in step.after), default=now)
        ends[index] = max(begins, find_earliest_start(state, run, index, ends)) + find_usual_time(state, step)
    return max(ends.values(), default=now) - now
