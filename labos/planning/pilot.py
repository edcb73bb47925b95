"""Chooses which waiting run starts next, with a look ahead (the pilot method).

If labware stays on its module until the next one is free, the run that starts now may block a longer run
much later. So before a run starts, the workcell is simulated in a simplified model (``outline``): once with
each of the first runs that may start, and once with none of them. Then the run starts for which all known
work ends soonest. No result is kept from one decision to the next.

It chooses only between runs of equal rank: the same priority, and users with the same share. It does not
choose if all runs are of one kind, or if their later steps are not known (see ``are_different``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import msgspec

from labos.core import reasons
from labos.core.ids import module_key, split_key
from labos.core.reasons import AnyReason
from labos.core.recurrence import in_zone
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.planning.outline import Outline, Ways
from labos.planning.touch import cell_key, near_key

MOST_WAITING = 8
"""The most waiting runs in a simulation. If more of equal rank wait, there is no look ahead: the end of all
work then depends little on which run is next."""

MOST_OPTIONS = 4
"""The most runs that are tried. In one more simulation, no run starts for now."""

MARGIN = 0.02
"""A run may start before its second place is free, if all work then ends sooner by at least this part of the
time that is left."""


class Candidate(msgspec.Struct, frozen=True):
    """A run with one of its plans, and the step with which it may start. ``early``: according to the
    forecast, the place after that step is not free soon."""

    run: RunState
    step: int
    early: bool = False


Value = tuple[int, int]
"""The result of a simulation: less is better (see ``Outline.value``)."""


class Pilot:
    """Chooses which run starts. ``plays`` is the number of simulations for choices."""

    def __init__(self) -> None:
        self._ways: dict[str, Ways] = {}
        self.plays = 0

    def forget(self, cell: str) -> None:
        """Forget what is known of a workcell, because its bench has changed."""
        self._ways.pop(cell, None)

    def choose(
        self,
        state: LabState,
        first: Candidate,
        others: Sequence[RunState],
        now: int,
        find_candidate: Callable[[RunState], Candidate | None],
    ) -> Candidate | Wait:
        """The run that starts now: ``first`` if all results are equal, or another candidate. If no run should
        start now, the wait of ``first``."""
        cell = state.runs.plan_of(first.run).workcell
        waiting = [first.run, *others]
        base = len(state.runs.list_inside(cell))
        outline = Outline(state, cell, waiting, now, self._ways.setdefault(cell, Ways()))
        if not outline.is_safe:
            return _make_wait(state, outline, cell) if first.early else first
        plays: list[tuple[Value, int | None]] = []  # None as number: no run starts for now
        for number, run in enumerate(waiting):
            step = first.step if not number else state.runs.plans[run.plan].starts[0]
            witness = None
            if len(plays) < MOST_OPTIONS and outline.is_free(base + number, step):
                witness = outline.find_witness(base + number, step)
            if witness is not None:
                plays.append((self._play(outline, base + number, step, witness), number))
        if not first.early and (not plays or plays[0][1]):
            return first  # the outline finds no way to admit it
        if outline.flying and state.actions.is_any_moving(cell):
            later = outline.copy()
            later.advance()
            self.plays += 1
            plays.append((later.go_on().value, None))
        early: Candidate | None = None
        early_end = 0
        for value, chosen in sorted(plays, key=lambda play: (play[0], play[1] is None, play[1] or 0)):
            if chosen is None:
                candidate = None
            else:
                candidate = first if not chosen else find_candidate(waiting[chosen])
                if candidate is None:
                    continue
                if candidate.early:
                    early, early_end = (candidate, value[1]) if early is None else (early, early_end)
                    continue
            if early is not None and early_end <= value[1] - MARGIN * (value[1] - now):
                return early
            return candidate or self._explain(state, outline, base, first.step, cell)
        return early or first

    def _play(self, outline: Outline, who: int, step: int, witness: list[int]) -> Value:
        """The result of a simulation in which this run starts now."""
        self.plays += 1
        play = outline.copy()
        play.start(who, step, witness)
        return play.go_on().value

    def _explain(self, state: LabState, outline: Outline, who: int, step: int, cell: str) -> Wait:
        """The wait of a run that should not start now. It names the started run that would wait longest."""
        play = outline.copy()
        seen: dict[tuple[int, int], tuple[int, int]] = {}

        def see(now: Outline) -> None:
            held = now.list_held(who)
            for other in range(len(outline.inside)):
                for turn in now.turns[other] if outline.inside[other] else ():
                    key = next((k for k in now.find_in_the_way(other, turn) if k in held), None)
                    if key is not None:
                        seen.setdefault((other, turn), (key, now.now))

        witness = outline.find_witness(who, step)
        if witness is None or not outline.is_free(who, step):
            return _make_wait(state, outline, cell)
        play.start(who, step, witness)
        play.go_on(see)
        begun = {(other, turn): at for at, other, turn in play.order}
        waits = [(begun[which] - at, which, key) for which, (key, at) in seen.items() if which in begun]
        if not waits:
            return _make_wait(state, outline, cell)
        _, which, key = max(waits)
        place = split_key(self._ways[cell].names[key])[1]
        why = reasons.HoldsUp(str(outline.runs[which[0]].id), place, in_zone(begun[which], "UTC"))
        return _make_wait(state, outline, cell, why)


def _make_wait(state: LabState, outline: Outline, cell: str, why: AnyReason | None = None) -> Wait:
    """A wait that ends when anything changes on which the look ahead depends."""
    modules = {step.module: True for run in outline.runs for step in state.runs.plan_of(run).steps}
    on = (cell_key(cell), near_key(cell), *map(module_key, modules))
    return Wait(why or reasons.SoonerLater(), on)


def are_different(state: LabState, runs: Sequence[RunState], run: RunState) -> bool:
    """Whether some runs are of another kind than this one, and the later steps of all are known. That is so
    without windows, without an experiment that may submit more runs, and without a waiting run with a choice
    of modules."""
    return any(other.plan != run.plan for other in runs) and not any(
        other.experiment or state.runs.plans[other.plan].windowed or (other.choices and not other.has_started)
        for other in (*runs, run)
    )
