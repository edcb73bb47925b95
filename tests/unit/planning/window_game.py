"""Windows as a game in whole seconds: the lab says when steps start, nature when they end.

Played out in full, it says of very small plans whether the lab can keep all windows, whatever nature does.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

from labos.core.model import Plan
from labos.planning.certificate import find_order

OPEN = -1_000
"""A step that has not started. One that runs counts up from 0; one that is over down from -1."""

State = tuple[int, ...]


class Game:
    """``ranges`` are least and greatest durations in whole seconds. Modules are used in the plan's order."""

    def __init__(self, plan: Plan, ranges: Sequence[tuple[int, int]]) -> None:
        self.plan, self.ranges = plan, ranges
        self.windows = [
            (i, w.anchor, int(w.wait_s), None if w.within_s is None else int(w.within_s))
            for i, s in enumerate(plan.steps)
            for w in s.windows
            if w.anchor is not None
        ]
        longest = max([0, *(wait for *_, wait, _ in self.windows), *(most or 0 for *_, most in self.windows)])
        self.oldest = -longest - 2
        self.before = [{*step.after} for step in plan.steps]
        last: dict[str, int] = {}
        for i in find_order(plan):
            module = plan.steps[i].module
            if plan.steps[i].exclusive and module in last:
                self.before[i].add(last[module])
            last[module] = i
        self.first: State = (OPEN,) * len(plan.steps)
        self._known: dict[State, bool] = {}

    def may_start(self, state: State, i: int) -> bool:
        return (
            state[i] == OPEN
            and all(OPEN < state[b] < 0 for b in self.before[i])
            and all(-1 - state[a] >= wait for j, a, wait, _ in self.windows if j == i)
        )

    def is_missed(self, state: State) -> bool:
        """Whether a step that has not started is too late now."""
        return any(
            most is not None and state[i] == OPEN and OPEN < state[a] < 0 and -1 - state[a] > most
            for i, a, _, most in self.windows
        )

    def tick(self, state: State) -> State:
        return tuple(s if s == OPEN else s + 1 if s >= 0 else max(s - 1, self.oldest) for s in state)

    def endings(self, state: State) -> Iterator[State]:
        """What nature may let end now: all that must, and any of what may."""
        must = [i for i, s in enumerate(state) if s >= 0 and s == self.ranges[i][1]]
        may = [i for i, s in enumerate(state) if s >= self.ranges[i][0] and s < self.ranges[i][1] and s >= 0]
        for count in range(len(may) + 1):
            for some in combinations(may, count):
                yield self.end(state, [*must, *some])

    def end(self, state: State, steps: Sequence[int]) -> State:
        return tuple(-1 if i in steps else s for i, s in enumerate(state))

    def moves(self, state: State) -> Iterator[State]:
        """What the lab may let start now, as many as possible first."""
        ready = [i for i in range(len(state)) if self.may_start(state, i)]
        for count in range(len(ready), -1, -1):
            for some in combinations(ready, count):
                yield tuple(0 if i in some else s for i, s in enumerate(state))

    def choose(self, state: State) -> State | None:
        """The first move by which the lab wins."""
        return next((after for after in self.moves(state) if self._survives(state, after)), None)

    def _survives(self, state: State, after: State) -> bool:
        later = self.tick(after)
        if later == state and OPEN in state:
            return False  # nothing comes of waiting
        return all(self.wins(then) for then in self.endings(later))

    def wins(self, state: State) -> bool:
        """Whether the lab, whose move it is, can keep all windows."""
        if OPEN not in state:
            return True
        if state not in self._known:
            self._known[state] = not self.is_missed(state) and self.choose(state) is not None
        return self._known[state]
