"""Decides where a run waits that cannot reach its end: if possible, where it does not block other runs.

A run that needs a module that is down goes on as far as it can. It would stop in front of that module,
perhaps in a device that every run needs, or with a hold on one. So before a step that changes the bench, the
run's way up to that module is checked. If the run comes to a place at which it blocks no other run, it may go
on. If it comes to none, and blocks no other run where it is now, it waits here until the module is back.
"""

from __future__ import annotations

from collections.abc import Iterator

from labos.core import reasons
from labos.core.binding import check_door_open
from labos.core.effects import list_places
from labos.core.ids import ModuleName, RunId, module_key, split_key
from labos.core.model import PlanStep
from labos.core.runs import RunState, RunStatus
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.planning.floor import Actor, Floor
from labos.planning.forecast import list_left
from labos.planning.layout import is_down, lay_out
from labos.planning.moves import move
from labos.planning.safety import Safety
from labos.planning.stuck import find_block
from labos.planning.touch import cell_key, near_key

DOWN = (reasons.NoModule, reasons.ModuleDown, reasons.OutOfService)
"""The reasons why a run waits that needs a module that is down."""


def check_should_stay(state: LabState, safety: Safety, run: RunState, step: int) -> Wait | None:
    """The wait of a run inside that should stay where it is instead of starting a step; None if it may start
    the step. A run with a running clock goes on as far as it can."""
    if run.status != RunStatus.ACTIVE or run.id in state.runs.windowed:
        return None
    wait = find_block(state, run)
    if wait is None or not isinstance(wait.reason, DOWN):
        return None
    plan = state.runs.plan_of(run)
    left = list_left(state, run)
    dead = {s.module for s in left if is_down(state, s.module)}
    wanted = _find_wanted(state, run)
    actor = safety.make_actor(state, run)
    floor = lay_out(state, plan.workcell, [actor], hopeful=True)
    if not wanted.isdisjoint(_find_kept(floor, actor)):
        return None  # it blocks others here too
    stands = list(_list_kept(state, floor, actor, step, dead))
    if not stands or any(wanted.isdisjoint(kept) for kept in stands):
        return None
    keys = (cell_key(plan.workcell), near_key(plan.workcell), *map(module_key, sorted(dead)))
    return Wait(reasons.BetterHere(plan.steps[step].key, tuple(sorted(dead))), keys)


def _find_wanted(state: LabState, run: RunState) -> set[str]:
    """What a run that stops should not keep from others: each module, because a run that needs it may come;
    and the places on the ways of runs that are inside or waiting and can reach their ends."""
    cell = state.runs.plan_of(run).workcell
    wanted: set[str] = {name for name, _ in state.modules.list_in_cell(cell)}
    for known in state.runs.plans.values():
        if known.plan.workcell == cell and not any(is_down(state, s.module) for s in known.plan.steps):
            wanted.update(place for s in known.plan.steps for place in list_places(s.effects))
    for other in state.runs.list_inside(cell):
        if other.id != run.id and find_block(state, other) is None:
            wanted.update(place for s in list_left(state, other) for place in list_places(s.effects))
    return wanted


def _list_kept(
    state: LabState, floor: Floor, actor: Actor, step: int, dead: set[ModuleName]
) -> Iterator[set[str]]:
    """What the run keeps from others after each step on its way, from this step on, until it stops at a
    module that is down."""
    steps = state.runs.plan_of(state.runs.active[RunId(actor.name)]).steps
    first = [motion for motion in actor.motions if motion.step == step]
    way = [*first, *(motion for motion in actor.motions if motion.step != step)]
    for number, motion in enumerate(way):
        if isinstance(motion.step, int) and _needs_closed_module(state, steps[motion.step], dead):
            return
        move(floor, actor, motion)
        if number + 1 == len(way) or way[number + 1].step != motion.step:
            yield _find_kept(floor, actor)
    yield set()  # its way forks before it stops: where it stops is not known


def _needs_closed_module(state: LabState, step: PlanStep, dead: set[ModuleName]) -> bool:
    """Whether a step needs a module that is down. Also True if a hand would have to reach into such a module,
    and it is shut or its position is unknown, because its node was lost during an action."""
    if step.module in dead:
        return True
    reached = [
        place for place in list_places(step.effects) if state.bench.stations[place].spec.module in dead
    ]
    modules = [state.modules.by_name.get(state.bench.stations[place].spec.module) for place in reached]
    return any(module is None or module.cut_off for module in modules) or any(
        check_door_open(state, place) for place in reached
    )


def _find_kept(floor: Floor, actor: Actor) -> set[str]:
    """The modules and places that a run keeps from others: by its labware, by doors and lids away from rest,
    by setpoints, and by its plan's holds."""
    stands = [place for place, number in actor.own.items() if number and place not in floor.endless]
    kept: set[str] = {place for place in stands if floor.count[place] >= floor.capacity.get(place, 0)}
    kept.update(floor.claims[place] for place in stands if place in floor.claims)
    kept.update(floor.arms[place] for place in stands if place in floor.arms)
    for key, holders in floor.held.items():
        if actor.name in holders:
            kept.add(split_key(key)[1])
    return kept
