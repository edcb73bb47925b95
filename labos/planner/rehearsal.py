"""What would come of a suggestion: a copy of the lab carried on with it, by the lab's own rules and planning.

So a planner is never worse than none, as far as its durations are right: what it suggests is held against
what the lab would do without, and is sent only if it is better.
"""

from __future__ import annotations

import msgspec
from msgspec.structs import replace

from labos.core.actions import Action
from labos.core.decide.suggestions import SuggestOrder
from labos.core.lengths import Lengths
from labos.core.model import PlanStep
from labos.core.state import LabState, from_picture, picture
from labos.core.suggestions import OrderSuggested
from labos.planner.lengths import at_level, draw
from labos.planner.problem import GOES_ON, MOST_WAITING
from labos.planning.virtual import Lasts, Play, VirtualLab, keep_first

DRAWN = 3
"""So many plays with durations that were drawn are added where windows have to be kept."""


class Score(msgspec.Struct, frozen=True, order=True):
    """How good a play was, the less the better: runs that did not come to their ends, windows that were
    missed, and seconds of wall time: the end of all with that of each run of an experiment, and all ends."""

    stays: int
    missed: int
    cost_s: float
    ends_s: float


class OrderRehearsal:
    """Carries copies of a workcell on. ``level`` is the quantile of durations with which it is planned."""

    def __init__(self, state: LabState, cell: str, now: int, level: float) -> None:
        self.cell, self.now, self.level = cell, now, level
        copy = from_picture(picture(state))
        copy.lab.paused.clear()  # what is paused goes on some time, and in the same order
        keep_first(copy, MOST_WAITING)
        copy.recorded_at = max(copy.recorded_at, now)
        self.order = copy.suggestions.orders.get(cell)
        self.has_windows = any(
            step.windows for known in copy.runs.plans.values() for step in known.plan.steps
        )
        self._base = picture(copy)

    def score(self, order: SuggestOrder | OrderSuggested | None) -> Score:
        """How it would go with this order; with none if there is none."""
        plays = [self._play(order, number) for number in range(1 + DRAWN * self.has_windows)]
        scores = [self._judge(play) for play in plays]
        return replace(
            scores[0],
            stays=sum(score.stays for score in scores),
            missed=sum(score.missed for score in scores),
        )

    def _play(self, order: SuggestOrder | OrderSuggested | None, number: int) -> Play:
        state = from_picture(self._base)
        state.suggestions.orders.pop(self.cell, None)
        if order is not None:
            state.suggestions.orders[self.cell] = OrderSuggested(
                order.workcell, order.by, order.until, order.steps
            )
        return VirtualLab(state, self.now, _lasts(state.lengths, state.lab.pace, self.level, number)).go_on()

    def _judge(self, play: Play) -> Score:
        ends = {run: (end - self.now) / 1e9 for run, end in play.ends.items()}
        goes_on = sum(end for run, end in ends.items() if run in play.experiments)
        cost_s = max(ends.values(), default=0.0) + GOES_ON * goes_on
        return Score(len(play.stays), play.missed, cost_s, sum(ends.values()))


def _lasts(lengths: Lengths, pace: float, level: float, number: int) -> Lasts:
    """Number 0 takes the durations that are planned with; others draw them."""

    def lasts(action: Action, step: PlanStep) -> int:
        drawn = draw(f"{number}/{action.run}/{action.step}/{action.attempt}") if number else level
        return at_level(lengths, step, pace, drawn)

    return lasts
