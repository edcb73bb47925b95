"""How much of a run follows after each of its steps. Of its branches, the longest goes first."""

from __future__ import annotations

from collections.abc import Sequence

from labos.core.branches import sort_by_predecessors
from labos.core.model import Plan
from labos.core.state import LabState

MOST_PLANS = 4096
"""The most plans that are remembered."""


class WorkBehind:
    """For each step of a plan, the longest path from its start to the end of the run, by nominal
    durations."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[float, ...]] = {}

    def measure(self, state: LabState, plan: str, step: int) -> float:
        """The longest path from the start of a step to the end of the run (seconds)."""
        found = self._known.get(plan)
        if found is None:
            if len(self._known) >= MOST_PLANS:
                self._known.clear()
            found = self._known[plan] = _measure_longest_ways(state.runs.plans[plan].plan)
        return found[step]

    def sort(self, state: LabState, plan: str, steps: Sequence[int]) -> Sequence[int]:
        """The steps of a plan, the one with the longest path first."""
        if len(steps) < 2:
            return steps
        return sorted(steps, key=lambda step: -self.measure(state, plan, step))


def _measure_longest_ways(plan: Plan) -> tuple[float, ...]:
    found = [0.0 for _ in plan.steps]
    behind = list(found)
    for index in reversed(sort_by_predecessors({i: step.after for i, step in enumerate(plan.steps)})):
        found[index] = plan.steps[index].duration_s + behind[index]
        for before in plan.steps[index].after:
            behind[before] = max(behind[before], found[index])
    return tuple(found)
