"""How much of a run follows after each of its steps. Of its branches, the longest goes first."""

from __future__ import annotations

from collections.abc import Sequence

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
    found = [step.duration_s for step in plan.steps]
    followers: dict[int, list[int]] = {}
    for index, step in enumerate(plan.steps):
        for before in step.after:
            followers.setdefault(before, []).append(index)
    left = set(range(len(found)))
    while left:
        ready = [index for index in left if left.isdisjoint(followers.get(index, ()))]
        for index in ready:
            found[index] += max((found[other] for other in followers.get(index, ())), default=0.0)
        left.difference_update(ready)
        if not ready:
            break
    return tuple(found)
