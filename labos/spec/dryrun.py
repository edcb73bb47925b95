"""Carries out a plan's effects on a model: it follows the labware and finds faults.

The dry run does not consider other runs. If a step uses labware that the run has not brought there, this
labware must be there when the run starts: these stations are the plan's inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from labos.core.model import PlanStep
from labos.spec.paper import Paper
from labos.spec.paperstep import DryRunStep


class DryRun(Paper):
    """The bench from the view of one run, and the effects of its steps on it."""

    def run(self, steps: Sequence[tuple[int, PlanStep]], after: Callable[[int], None] | None = None) -> None:
        """Carry out the steps in the given order. ``after`` is called after each of them."""
        is_conditional = any(step.when is not None for _, step in steps)
        for index, step in steps:
            if is_conditional:
                self.left.clear()
            DryRunStep(self, index, step).carry_out()
            if after is not None:
                after(index)
