"""Actors whose way forks: a step may fail and be skipped or recovered from.

Nobody can choose which branch such an actor goes. So it counts as one who reaches its end only if it
does so on every branch, one after the other from the same floor; and what it leaves for the others is
the worst of all branches: at each place the most labware that one of them leaves there. Up to the first
fork its motions may be mixed with others'; from there on it goes alone to its end.

A branch on which the run fails has to be possible too; what it leaves in the way, a person is asked to
take away, as after any failure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from labos.core.branches import Way, decided
from labos.core.model import MAIN, Plan
from labos.core.runs import DONE, IN_FLIGHT, PENDING, SKIPPED, RunState
from labos.planning.floor import Actor, Branch, Floor, Taken, change_claim, may_move, move, take_back
from labos.planning.paths import Motion, Path

FORKED = -2
"""The step number that stands in a witness for all that follows an actor's first fork."""

FORK = Motion(FORKED)

Change = tuple[dict[Any, int], Any, int]


class Ends(msgspec.Struct):
    """How an actor came to all its ends: the motions of one branch, carried out, and what had to be
    added to counts for the others."""

    motions: list[tuple[Motion, Taken | None]]
    changes: list[Change]


# -- which branches are left ---------------------------------------------------------------------


def futures(
    path: Path, plan: Plan, run: RunState, steps: Sequence[int], tail: tuple[Motion, ...]
) -> tuple[tuple[Motion, ...], tuple[Branch, ...]]:
    """What is left of a way that forks, given the states of the run's steps: the motions before the first
    fork, and the branches behind it. ``tail`` follows at the end of each."""
    troubles, known = run.troubles, decided(plan, steps, run.results)
    over = {
        index
        for index, status in enumerate(steps)
        if status in (DONE, IN_FLIGHT, SKIPPED)
        and (plan.steps[index].part == MAIN or str(plan.steps[index].part) in troubles)
    }
    branches: dict[tuple[Motion, ...], bool] = {}
    for way, motions in path.ways:
        if any(known.get(what, value) != value for what, value in way.said):
            continue
        if not _possible(way, plan, steps, troubles):
            continue
        left = tuple(motion for motion in motions if motion.step not in over)
        whole = (*_undone(path, way, steps), *left, *tail)
        branches[whole] = branches.get(whole, True) and way.fails
    lists = list(branches)
    common = 0
    while lists and all(len(m) > common and m[common] == lists[0][common] for m in lists):
        common += 1
    if len(lists) <= 1:
        return (lists[0] if lists else tail), ()
    forks = tuple(Branch(motions[common:], fails) for motions, fails in branches.items())
    return lists[0][:common], tuple(sorted(forks, key=lambda branch: branch.fails))


def _possible(way: Way, plan: Plan, steps: Sequence[int], troubles: Mapping[str, str]) -> bool:
    """Whether a run whose steps have these states may still go this way."""
    for index, status in enumerate(steps):
        if plan.steps[index].part != MAIN:
            continue
        in_trouble = str(index) in troubles
        if index in way.rescued:
            if status == DONE or (status == SKIPPED and not in_trouble):
                return False
        elif index in way.without:
            if status == DONE or in_trouble:
                return False
        elif index in way.steps:
            if in_trouble or status == SKIPPED:
                return False
        elif status not in (PENDING, SKIPPED) and not way.fails:
            return False
    return True


def _undone(path: Path, way: Way, steps: Sequence[int]) -> list[Motion]:
    """The motions that take back what is in flight and fails on this way: on the floor, what is in flight
    counts as arrived."""
    back: list[Motion] = []
    for index in way.without | way.rescued:
        if steps[index] != IN_FLIGHT:
            continue
        for motion in reversed(motions_of(path, index)):
            if motion.target:
                lid = {"off": "on", "on": "off"}.get(motion.lid, "")
                back.append(Motion(index, motion.target, motion.source, lid=lid))
            elif motion.grabs:
                back.append(Motion(index, frees=tuple(key for key, _ in motion.grabs)))
    return back


def motions_of(path: Path, step: int) -> list[Motion]:
    """The motions of a step, on whichever way it is done."""
    lists = [motions for _, motions in path.ways] if path.ways else [path.motions]
    for motions in lists:
        found = [motion for motion in motions if motion.step == step]
        if found:
            return found
    return []


# -- all branches at once ------------------------------------------------------------------------


def finish(floor: Floor, actor: Actor) -> Ends | None:
    """Let an actor that stands before its fork go to its end on every branch; None, and nothing
    changed, if one of them is blocked. What the floor holds then is the worst of all ends."""
    ends: list[dict[int, dict[Any, int]]] = []
    last: list[tuple[Motion, Taken | None]] = []
    lasting = [branch for branch in actor.forks if not branch.fails]
    for branch in [*(b for b in actor.forks if b.fails), *reversed(lasting)]:
        _back(floor, actor, last)
        last = []
        for motion in branch.motions:
            if not may_move(floor, actor, motion):
                _back(floor, actor, last)
                return None
            last.append((motion, move(floor, actor, motion)))
        if not branch.fails:
            ends.append({number: dict(table) for number, table in enumerate(_tables(floor, actor))})
    if not lasting:
        _back(floor, actor, last)
        last = []
    changes: list[Change] = []
    for number, table in enumerate(_tables(floor, actor)):
        worst = max if number < 2 else min
        for end in ends:
            for key in end[number].keys() | table.keys():
                value = worst(table.get(key, 0), end[number].get(key, 0))
                change = value - table.get(key, 0)
                if change:
                    changes.append((table, key, change))
                    table[key] = value
    _claim(floor, actor, changes, 1)
    return Ends(last, changes)


def unfinish(floor: Floor, actor: Actor, ends: Ends) -> None:
    """Take back what ``finish`` did."""
    _claim(floor, actor, ends.changes, -1)
    for table, key, change in reversed(ends.changes):
        table[key] = table.get(key, 0) - change
    _back(floor, actor, ends.motions)


def _tables(floor: Floor, actor: Actor) -> list[dict[Any, int]]:
    """Counts of which the others would rather see less (two), then those of which they want more."""
    pools = [floor.pools[owner] for owner in actor.inputs if owner in floor.pools]
    return [floor.count, actor.own, floor.stock, *pools]


def _claim(floor: Floor, actor: Actor, changes: list[Change], sign: int) -> None:
    for table, key, change in changes:
        if table is actor.own:
            change_claim(floor, key, actor.name, sign * change)


def _back(floor: Floor, actor: Actor, trail: list[tuple[Motion, Taken | None]]) -> None:
    for motion, taken in reversed(trail):
        take_back(floor, actor, motion, taken)


__all__ = ["FORK", "FORKED", "Ends", "finish", "futures", "motions_of", "unfinish"]
