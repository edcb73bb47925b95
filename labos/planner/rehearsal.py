"""The effects of a suggestion: a copy of the lab continues with it, under the lab's own rules and planning.

So a planner is never worse than none, as far as its durations are right: its suggestion is compared with the
course of the lab without it, and is sent only if it is better.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import msgspec

from labos.core.actions import Action
from labos.core.decide.suggestions import SuggestOrder
from labos.core.fold import evolve
from labos.core.ids import RunId
from labos.core.lengths import Lengths
from labos.core.model import PlanStep
from labos.core.runs import RunCancelled, RunState
from labos.core.state import LabState, encode_picture, from_picture
from labos.core.structs import make_from
from labos.core.suggestions import OrderSuggested
from labos.planner.lengths import draw, estimate_at_level
from labos.planner.measure import Score, judge, rate_runs
from labos.planning.own_order import OwnOrder
from labos.planning.suggested import GRACE_S
from labos.planning.virtual import Lasts, Play, VirtualLab

DRAWN = 3
"""The number of additional plays with drawn durations, if there are windows."""

GAIN = 0.01
"""A way is better than another if it is better by this part, and by more than the time for which a step waits
for another one in vain: less than that is lost as soon as durations vary."""

Order = SuggestOrder | OrderSuggested


class Way(msgspec.Struct):
    """One way to continue: with an order, or without. ``plays`` are the plays so far; the first one has the
    durations of the plan."""

    order: Order | None
    plays: list[Play]


class OrderRehearsal:
    """Continues copies of a workcell with these runs; other waiting runs are left out. ``level`` is the
    quantile of durations for planning. ``drawn`` is the number of plays with drawn durations, if there are
    windows; 0: durations are exact, so any gain counts. The end of all counts ``end_weight`` times as much as
    the mean of all ends. ``searches``: the lab looks for an order of its own where none is suggested.
    ``overtaken`` says how often each waiting run was overtaken before."""

    def __init__(
        self,
        state: LabState,
        cell: str,
        now: int,
        level: float,
        runs: Sequence[RunState],
        *,
        drawn: int = DRAWN,
        end_weight: int = 1,
        searches: bool = False,
        overtaken: Mapping[RunId, int] = MappingProxyType({}),
    ) -> None:
        self.cell, self.now, self.level, self.end_weight = cell, now, level, end_weight
        self._overtaken = overtaken
        self._orders: dict[str, OwnOrder] | None = {} if searches else None
        copy = from_picture(encode_picture(state))
        copy.lab.paused.clear()  # paused work will continue at some time, and in the same order
        known = {run.id for run in runs}
        for name in [name for name in copy.runs.queued if name not in known]:
            evolve(copy, RunCancelled(name), copy.position + 1, copy.recorded_at)
        copy.recorded_at = max(copy.recorded_at, now)
        self.order = copy.suggestions.find(cell, now)
        windowed = any(state.runs.plans[run.plan].windowed for run in runs)
        self._most = 1 + drawn * windowed
        self._gain = (GAIN, GRACE_S / copy.lab.pace) if drawn else (0.0, 0.0)
        self._rated = rate_runs(copy, runs, now)
        self._lengths = copy.lengths
        self._base = encode_picture(copy)

    def go(self, order: Order | None) -> Way:
        """A way with this order (or with none), played once."""
        way = Way(order, [])
        self._play(way)
        return way

    def list_starts(self, way: Way) -> dict[tuple[RunId, int], int]:
        """When steps would start (UTC ns)."""
        return way.plays[0].begun

    def may_be_better(self, ends: Mapping[RunId, int], other: Way) -> bool:
        """Whether a way in which the runs end at these times (UTC ns) would be better than another one, with
        the durations of the plan."""
        ideal = judge([Play(ends=dict(ends))], self._rated, self.now, self.end_weight)
        return ideal.is_better_than(self._compute_score(other, 1), *self._gain)

    def is_better(self, one: Way, other: Way) -> bool:
        """Whether one way is clearly better than another: with the durations of the plan, and if there are
        windows also in all plays together. By chance, a single play with drawn durations may show the
        contrary."""
        return all(self._compare(one, other, plays) for plays in (1, self._most))

    def is_as_good(self, one: Way, other: Way) -> bool:
        """Whether one way is not clearly worse than another, in the same plays."""
        return not any(self._compare(other, one, plays) for plays in (1, self._most))

    def _compare(self, one: Way, other: Way, plays: int) -> bool:
        """Whether one way is clearly better in so many plays."""
        for way in (one, other):
            while len(way.plays) < plays:
                self._play(way)
        return self._compute_score(one, plays).is_better_than(self._compute_score(other, plays), *self._gain)

    def _compute_score(self, way: Way, plays: int) -> Score:
        return judge(way.plays[:plays], self._rated, self.now, self.end_weight)

    def _play(self, way: Way) -> None:
        state, order = from_picture(self._base), way.order
        state.suggestions.orders.pop(self.cell, None)
        if order is not None:
            state.suggestions.orders[self.cell] = make_from(OrderSuggested, order)
        lasts = _make_lasts(self._lengths, state.lab.pace, self.level, len(way.plays))
        lab = VirtualLab(state, self.now, lasts, orders=self._orders, overtaken=self._overtaken)
        way.plays.append(lab.go_on())


def _make_lasts(lengths: Lengths, pace: float, level: float, number: int) -> Lasts:
    """Number 0 has the durations of the plan; the others have drawn ones. ``lengths`` are those before any
    play: what a play learns depends on its order, and a step has to take as long in each way."""

    def lasts(action: Action, step: PlanStep) -> int:
        drawn = draw(f"{number}/{action.run}/{action.step}/{action.attempt}") if number else level
        return estimate_at_level(lengths, step, pace, drawn)

    return lasts
