"""Runs a plan's effects on paper: where its labware goes, and what cannot work.

The dry run knows nothing of other runs. What a step uses without the run having brought it
there must stand there when the run starts: these stations are the plan's inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from labos.core.model import PlanStep
from labos.spec.paper import Paper
from labos.spec.paperstep import StepOnPaper


class DryRun(Paper):
    """The bench as far as one run knows it, and what its steps do to it."""

    def run(self, steps: Sequence[tuple[int, PlanStep]], after: Callable[[int], None] | None = None) -> None:
        """Go through the steps in the order given. ``after`` is called behind each of them."""
        is_conditional = any(step.when is not None for _, step in steps)
        for index, step in steps:
            if is_conditional:
                self.left.clear()
            StepOnPaper(self, index, step).carry_out()
            if after is not None:
                after(index)
