"""Actors whose way forks: a step may fail and be skipped or recovered from, or a condition may leave it out.

The scheduler cannot choose the branch that such an actor takes. So the actor reaches its end only if it does
so on every branch, each from the same floor. For the other actors, the worst of all branches counts: at each
place the most labware that one of them leaves there. Before the first fork, the motions of the actor and of
others may alternate. From the fork on, it goes alone to its end.

A branch on which the run fails has to be possible too. What it leaves in the way does not count: a person is
asked to take it away, as after any failure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from typing import Any

from labos.core.branches import Way, find_decided, may_leave_out
from labos.core.effects import NOWHERE, Relid, Unlid, list_arrivals
from labos.core.ids import ModuleName, StationName
from labos.core.model import MAIN, Plan
from labos.core.runs import DONE, IN_FLIGHT, PENDING, SKIPPED, UNKNOWN, RunState, StepStatus, find_results
from labos.planning.floor import OTHERS, UNSETTLED, Actor, Branch, Floor, change_claim
from labos.planning.moves import may_move, move
from labos.planning.paths import FORKED, Motion, Path, carry, name_leftover_owner

FORK = Motion(FORKED)

# -- which branches are left ---------------------------------------------------------------------


def find_branches(
    path: Path,
    plan: Plan,
    run: RunState,
    steps: Sequence[StepStatus],
    tail: tuple[Motion, ...],
    failing: tuple[Motion, ...] = (),
) -> tuple[tuple[Motion, ...], tuple[Branch, ...]]:
    """The rest of a way that forks, for these states of the run's steps: the motions before the first fork,
    and the branches behind it. Branches on which the run fails are last and end with ``failing``, the others
    with ``tail``."""
    troubles, known = _list_failed(run), find_decided(plan, steps, find_results(plan, run))
    over = {
        index
        for index, status in enumerate(steps)
        if status in (DONE, IN_FLIGHT, SKIPPED)
        and (plan.steps[index].part == MAIN or plan.steps[index].part in troubles)
    }
    branches: dict[tuple[Motion, ...], bool] = {}
    possible = [
        (way, motions)
        for way, motions in path.ways
        if all(known.get(what, value) == value for what, value in way.decisions)
        and _is_possible(way, plan, steps, troubles)
    ]
    flying = _list_undecided([way for way, _ in possible], run, steps)
    for way, motions in possible:
        left = tuple(motion for motion in motions if motion.step not in over)
        outcome = [motion for index in flying for motion in _list_outcome(path, way, motions, index)]
        whole = (*outcome, *left, *(failing if way.fails else tail))
        branches[whole] = branches.get(whole, True) and way.fails
    lists = list(branches)
    common = 0
    while lists and all(len(m) > common and m[common] == lists[0][common] for m in lists):
        common += 1
    if len(lists) <= 1:
        return (lists[0] if lists else tail), ()
    # The motions of one step stay together: if they differ between branches, all of them are in the branches.
    while common and any(len(m) > common and m[common].step == m[common - 1].step for m in lists):
        common -= 1
    forks = tuple(Branch(motions[common:], fails) for motions, fails in branches.items())
    return lists[0][:common], tuple(sorted(forks, key=lambda branch: branch.fails))


def _is_possible(way: Way, plan: Plan, steps: Sequence[StepStatus], troubles: Collection[int]) -> bool:
    """Whether a run whose steps have these states may still take this way."""
    for index, status in enumerate(steps):
        if plan.steps[index].part != MAIN:
            continue
        in_trouble = index in troubles
        if index in way.rescued:
            if status == DONE or (status == SKIPPED and not in_trouble):
                return False
        elif index in way.without:
            if status == DONE or in_trouble:
                return False
        elif index in way.steps:
            if (in_trouble or status == SKIPPED) and not may_leave_out(plan, index):
                return False
        elif status not in (PENDING, SKIPPED) and not way.fails:
            return False
    return True


def _list_failed(run: RunState) -> frozenset[int]:
    """The steps that failed and whose recovery has begun."""
    return frozenset(index for index, step in enumerate(run.steps) if step.trouble is not None)


def _list_undecided(ways: Sequence[Way], run: RunState, steps: Sequence[StepStatus]) -> list[int]:
    """The steps in flight that may fail and be skipped or recovered from. A step with an unknown outcome is
    not listed: it counts as done, as on the floor."""
    failing = {index for way in ways for index in way.without | way.rescued}
    doubtful = {index for index, step in enumerate(run.steps) if step.status == UNKNOWN}
    return sorted(index for index in failing - doubtful if steps[index] == IN_FLIGHT)


def find_kept(path: Path, plan: Plan, run: RunState, steps: Sequence[StepStatus]) -> list[Motion]:
    """What has to be kept for the steps in flight that may fail, because their outcome is not known yet: the
    places from which their labware comes, and what they release. A setpoint that they change cannot be
    shared, because it may keep its old value."""
    possible = [
        (way, motions) for way, motions in path.ways if _is_possible(way, plan, steps, _list_failed(run))
    ]
    grabs = {grab: True for _, motions in path.ways for motion in motions for grab in motion.grabs}
    changing = {key for key, number in Counter(key for key, _ in grabs).items() if number > 1}
    values = {key: None if key in changing else value for key, value in grabs}
    kept: list[Motion] = []
    for index in _list_undecided([way for way, _ in possible], run, steps):
        kept += [Motion(index, place, back=True) for place in _find_left(list_motions(path, index))]
        own = [motion for _, motions in possible for motion in motions if motion.step == index]
        held = {key: values.get(key) for motion in own for key in motion.frees}
        held |= {key: None for motion in own for key, _ in motion.grabs if key in changing}
        if held:
            kept.append(Motion(index, grabs=tuple(held.items())))
    return kept


def _find_left(motions: Iterable[Motion]) -> list[StationName]:
    """The places that labware leaves with these motions, and to which it returns if they fail."""
    return [motion.emptied for motion in motions if motion.emptied and not motion.new]


def _list_outcome(path: Path, way: Way, on_way: Sequence[Motion], index: int) -> list[Motion]:
    """The motions with which a step in flight ends on this way. On the floor the step counts as done, and
    what ``find_kept`` lists is kept in case it fails. If it fails on this way, its motions are undone."""
    motions = list_motions(path, index)
    found = [Motion(index, place, back=True) for place in _find_left(motions)]
    if index not in way.without | way.rescued:
        done = [motion for motion in on_way if motion.step == index]
        return found + [Motion(index, grabs=m.grabs, frees=m.frees) for m in done if m.grabs or m.frees]
    for motion in reversed(motions):
        if motion.lid:
            undone = (Relid if motion.lid == "off" else Unlid)(motion.target, motion.source)
            found += carry(
                index, undone, uses=ModuleName(""), hand=NOWHERE, guarded=(), room=list_arrivals((undone,))
            )
        elif motion.target:
            found.append(Motion(index, motion.target, motion.source, new=motion.new, back=True))
    return found


def list_motions(path: Path, step: int) -> list[Motion]:
    """The motions of a step, from a way that contains it. If several ways do, it is the one on which the step
    releases least, because the step may be the last on one way but not on another."""
    lists = [motions for _, motions in path.ways] if path.ways else [path.motions]
    found = [[motion for motion in motions if motion.step == step] for motions in lists]
    return min(filter(None, found), key=lambda motions: sum(len(m.frees) for m in motions), default=[])


# -- all branches at once ------------------------------------------------------------------------


def finish(floor: Floor, actor: Actor) -> bool:
    """Let an actor that is at its fork go to its end on every branch. The floor then has the worst of all
    ends. Returns False, without a change, if a branch is blocked."""
    mark = len(floor.changes)
    ends: list[list[dict[Any, int]]] = []
    values: list[dict[str, Any]] = []
    lasting = [branch for branch in actor.forks if not branch.fails]
    for branch in [*(b for b in actor.forks if b.fails), *reversed(lasting)]:
        floor.take_back(mark)
        for motion in branch.motions:
            if not may_move(floor, actor, motion):
                floor.take_back(mark)
                return False
            move(floor, actor, motion)
        if not branch.fails:
            values.append(dict(floor.values))
            ends.append([dict(table) for table in _list_tables(floor, actor)])
    if not lasting:
        floor.take_back(mark)
        for motion in actor.forks[0].motions if actor.forks else ():
            if motion.heir:
                move(floor, actor, motion)
    for number, table in enumerate(_list_tables(floor, actor)):
        worst = max if number < 3 else min
        for end in ends:
            for key in end[number].keys() | table.keys():
                change = worst(table.get(key, 0), end[number].get(key, 0)) - table.get(key, 0)
                if change:
                    floor.add(table, key, change)
                    if number in (1, 2):
                        change_claim(floor, key, actor.name if number == 1 else OTHERS, change)
    for key, value in list(floor.values.items()) if values else ():
        if any(other.get(key) != value for other in values):
            floor.put(floor.values, key, UNSETTLED)
    return True


def _list_tables(floor: Floor, actor: Actor) -> list[dict[Any, int]]:
    """First the counts of which less is better for other actors: all labware, the actor's own, and what it
    leaves for its closing workflow. Then those of which more is better: stock, and its inputs' pools."""
    pools = [floor.pools[owner] for owner in actor.inputs if owner in floor.pools]
    left = floor.pools.setdefault(name_leftover_owner(actor.home), {}) if actor.home else {}
    return [floor.count, actor.own, left, floor.stock, *pools]
