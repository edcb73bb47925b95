"""Makes the floor of a workcell from the state.

Labware in flight counts as arrived.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from labos.core.algebra import (
    ModuleSettings,
    compute_settings_after,
    list_away_from_rest,
)
from labos.core.bench import Bench, Labware
from labos.core.binding import check_module
from labos.core.decide.together import find_planned_wish
from labos.core.effects import find_labware_used, list_carried
from labos.core.ids import (
    SHARED,
    ActionId,
    LabwareId,
    ModuleName,
    Owner,
    RunId,
    StationName,
    find_owning_run,
    split_key,
    workcell_of,
)
from labos.core.leaving import will_leave
from labos.core.model import Plan, Together
from labos.core.modules import Module
from labos.core.runs import IN_FLIGHT, PENDING, SETTLED, SKIPPED, UNKNOWN, RunState, RunStatus
from labos.core.state import LabState
from labos.planning.floor import OTHERS, Actor, Floor, change_claim
from labos.planning.held import door_key, hold_key, joint_claim, ready_key, setpoint_key, variable_key
from labos.planning.moves import change_pile, go_back, move
from labos.planning.paths import Motion, is_joint


def is_down(state: LabState, module: ModuleName, *, recovered: bool = False) -> bool:
    """Whether a module can be used only after a person has acted or its device is back. If it is to be
    ``recovered`` first, an error does not count."""
    known = state.modules.by_name.get(module)
    return known is None or module in state.lab.paused or check_module(known, recovers=recovered) is not None


def find_standing(state: LabState, owner: Owner) -> tuple[dict[StationName, int], bool]:
    """The places of an owner's labware after all actions in flight have ended, with the number of pieces;
    and whether the place of a piece is unknown."""
    places: dict[StationName, int] = {}
    lost = False
    for item in state.bench.list_owned(owner):
        lost = lost or bool(item.maybe)
        place = find_destination(state.bench, item)
        if place:
            places[place] = places.get(place, 0) + 1
    for target in find_arriving(state, run) if (run := find_owning_run(owner)) else ():
        places[target] = places.get(target, 0) + 1
    return places, lost


def find_destination(bench: Bench, item: Labware) -> StationName:
    """The place of labware after the action that carries it has ended, with the name that plans use. Empty
    if the place is unknown or a waste, or for a lid on a plate."""
    place = item.station
    for what in list_carried(bench.reserved.get(ActionId(item.moving), ())) if item.moving else ():
        if what.labware == item.id:
            place = what.filled
    return (
        StationName("")
        if place and bench.stations[place].spec.kind == "waste"
        else bench.find_planned_place(place)
    )


def find_arriving(state: LabState, run: RunId) -> list[StationName]:
    """The stations at which labware arrives that a run is taking off a stack now."""
    active = state.runs.active.get(run)
    if active is None or not active.has(IN_FLIGHT, UNKNOWN):
        return []
    return [
        state.bench.find_planned_place(what.target)
        for action in state.actions.list_in_cell(state.runs.plan_of(active).workcell)
        if action.run == run
        for what in list_carried(action.effects)
        if what.stock
    ]


def list_labware_in(state: LabState, cell: str) -> list[Labware]:
    """The labware that stands in a workcell or is carried there, and all labware in the lab whose place is
    unknown. A lid on a plate is listed only if an action moves it."""
    bench = state.bench
    names: dict[LabwareId, bool] = {}
    for place in bench.in_cell.get(cell, ()):
        standing_there = bench.stations[place].labware
        if standing_there:
            names.update(dict.fromkeys(standing_there, True))
    for action in state.actions.list_in_cell(cell):
        if action.effects:
            names.update(dict.fromkeys(find_labware_used(action.effects), True))
    names.update(bench.lost)
    return [bench.labware[name] for name in names if name in bench.labware]


def lay_out(state: LabState, cell: str, actors: Sequence[Actor], *, hopeful: bool) -> Floor:
    """The floor of a workcell after all actions in flight have ended. Labware with an unknown place takes up
    room at each place where it may be. If ``hopeful``, an action with an unknown outcome counts as done. All
    shelves of a hotel are one place here: what one shelf accepts, each of them accepts."""
    bench = state.bench
    floor = Floor(held=_find_held(state, cell), values=_list_values(state, cell))
    joint = find_joint(state, cell)
    if joint:
        floor.held |= _find_ready(state, cell, joint)
    for name in bench.in_cell.get(cell, ()):
        station = bench.stations[name]
        spec = station.spec
        if spec.hotel:
            continue
        floor.capacity[name] = spec.capacity
        floor.count[name] = len(station.stock)
        if spec.kind == "stack":
            floor.stock[name] = len(station.stock)
            floor.piles[name] = ()
        elif spec.kind == "waste":
            floor.endless.add(name)
            floor.count[name] = station.count
        elif spec.kind == "gripper":
            floor.arms[name] = spec.module
        if spec.claim:
            floor.claims[name] = spec.claim
        elif spec.module in joint:
            floor.claims[name] = joint_claim(spec.module)
        if (spec.claim or spec.access) and spec.module:
            floor.behind[name] = spec.module
    holders = {owner: actor.name for actor in actors for owner in actor.owners}
    coming: list[tuple[StationName, str]] = []
    for item in list_labware_in(state, cell):
        if item.maybe and not (hopeful and item.moving):
            for place in map(bench.find_planned_place, item.maybe):
                floor.count[place] = floor.count.get(place, 0) + 1
                change_claim(floor, place, holders.get(item.owner, OTHERS), 1)
            continue
        place = find_destination(bench, item)
        if workcell_of(place) == cell:
            floor.count[place] = floor.count.get(place, 0) + 1
            if place in floor.piles and place != item.station:
                coming.append((place, holders.get(item.owner, item.owner)))
            change_claim(floor, place, holders.get(item.owner, OTHERS), 1)
            if item.owner not in holders and _is_pool(item.owner):
                pool = floor.pools.setdefault(item.owner, {})
                pool[place] = pool.get(place, 0) + 1
            if _is_pool(item.lender):
                floor.pools.setdefault(item.lender, {})
                if item.owner in holders:
                    who = holders[item.owner]
                    floor.lent[who] = (*floor.lent.get(who, ()), (place, item.lender))
    for stack in floor.piles:
        standing = (bench.labware[labware] for labware in bench.stations[stack].labware)
        staying = [item.owner for item in standing if find_destination(bench, item) == stack]
        floor.piles[stack] = tuple(holders.get(owner, owner) for owner in staying)
    for place, who in coming:
        floor.piles[place] = (*floor.piles[place], who)
    for action in state.actions.list_in_cell(cell):
        for effect in action.effects:
            for place in floor.endless.intersection(effect.room).intersection(effect.cleared):
                floor.count[place] -= 1  # it was counted with the arrivals under way
        for what in list_carried(action.effects):
            if what.stock in floor.stock:
                target = bench.find_planned_place(what.target)
                floor.stock[what.stock] -= 1
                floor.count[what.stock] -= 1
                floor.count[target] += 1
                change_pile(floor, target, str(action.run))
                change_claim(floor, target, str(action.run), 1)
    for actor in actors:
        keep_after_failure(floor, actor, actor.kept)
        hold_back_closing(floor, actor)
    return floor


def find_joint(state: LabState, cell: str) -> dict[ModuleName, Together]:
    """The modules of a workcell that do actions for several runs at once, with these actions."""
    pairs = ((name, module.spec.together) for name, module in state.modules.list_in_cell(cell))
    return {name: together for name, together in pairs if together is not None}


def _find_ready(
    state: LabState, cell: str, joint: Mapping[ModuleName, Together]
) -> dict[str, dict[str, Any]]:
    """The runs that are ready for an action that a module does for several runs at once: all steps before it
    have begun or are over. With the request of each run; None if it depends on results."""
    found: dict[str, dict[str, Any]] = {}
    for run in state.runs.list_inside(cell):
        plan = state.runs.plan_of(run)
        for step, at in zip(plan.steps, run.steps, strict=True):
            if at.status == PENDING and is_joint(joint, step):
                over = (run.steps[before].status in (IN_FLIGHT, UNKNOWN, *SETTLED) for before in step.after)
                if all(over):
                    found.setdefault(ready_key(step.module), {})[str(run.id)] = find_planned_wish(plan, step)
    return found


def hold_back_closing(floor: Floor, actor: Actor) -> None:
    """Make the closing workflow of an actor's experiment, if there is one, wait for the actor's end."""
    if actor.home:
        floor.put(floor.held.setdefault(actor.home, {}), actor.name, "inside")


def _is_pool(owner: Owner) -> bool:
    """Whether several runs may use the labware of an owner."""
    return split_key(owner)[0] in (SHARED, "user", "experiment")


def keep_after_failure(floor: Floor, actor: Actor, kept: Iterable[Motion]) -> None:
    """Keep on the floor what an actor needs if a step in flight fails."""
    for motion in kept:
        if motion.source:
            go_back(floor, actor, motion, -1)
        else:
            move(floor, actor, motion)


def _find_held(state: LabState, cell: str) -> dict[str, dict[str, Any]]:
    """What the runs inside hold after all actions in flight have ended: doors, setpoints, and modules that
    their plans hold."""
    inside = state.runs.in_cell.get(cell, {})

    def stays(who: str) -> bool:
        run = state.runs.active[RunId(who)] if RunId(who) in inside else None
        return run is not None and not _is_about_to_end(state.runs.plan_of(run), run)

    held: dict[str, dict[str, Any]] = {}
    for name, module in state.modules.list_in_cell(cell):
        flying = [
            (str(action.run), compute_settings_after(action.effects))
            for action in map(state.actions.open.__getitem__, module.in_flight)
        ]
        held[door_key(name)] = dict.fromkeys(filter(stays, _list_door_holders(module, flying)))
        for setpoint, now in module.setpoints.items():
            held[setpoint_key(name, setpoint)] = {who: now.value for who in now.holders if stays(who)}
        for run, after in flying:
            for setpoint, value in after.claims.items():
                if stays(run):
                    held.setdefault(setpoint_key(name, setpoint), {})[run] = value
            for setpoint in after.releases:
                held.get(setpoint_key(name, setpoint), {}).pop(run, None)
        holders = [state.runs.active[holder] for holder in state.runs.holders.get(name, ())]
        held[hold_key(name)] = {
            str(run.id): None for run in holders if _will_hold(state.runs.plan_of(run), run, name)
        }
    return {key: holders for key, holders in held.items() if holders}


def _list_values(state: LabState, cell: str) -> dict[str, Any]:
    """The values of modules' variables that have no rest position, after all actions in flight have ended."""
    values: dict[str, Any] = {}
    for name, module in state.modules.list_in_cell(cell):
        for variable, value in module.values.items():
            if variable not in module.spec.rest:
                values[variable_key(name, variable)] = value
        for action in module.in_flight:
            for variable, value in compute_settings_after(
                state.actions.open[action].effects
            ).variables.items():
                values[variable_key(name, variable)] = value
    return values


def _is_about_to_end(plan: Plan, run: RunState) -> bool:
    """Whether a run has no step left to start, even if a step in flight fails. When it ends, it releases all
    that it holds."""
    ends = run.status == RunStatus.CANCELLING and not will_leave(plan, run)
    policies = [
        step.on_error for step, at in zip(plan.steps, run.steps, strict=True) if at.status == IN_FLIGHT
    ]
    recovers = any(policy is not None and policy.do == "run" for policy in policies)
    return ends or (not recovers and all(step.status in (IN_FLIGHT, *SETTLED) for step in run.steps))


def _will_hold(plan: Plan, run: RunState, module: ModuleName) -> bool:
    """Whether a run's plan holds a module for it after all actions in flight have ended."""
    return any(
        hold.module == module
        and run.steps[hold.first].status not in (PENDING, SKIPPED)
        and run.steps[hold.last].status not in (IN_FLIGHT, *SETTLED)
        for hold in plan.holds
    )


def _list_door_holders(module: Module, flying: list[tuple[str, ModuleSettings]]) -> set[str]:
    """The runs that leave a door or lid away from its rest position, ``flying`` actions included."""
    if not module.spec.rest:
        return set()
    values = module.values
    by = {name: variable.by for name, variable in module.variables.items()}
    for run, after in flying:
        values |= after.variables
        by |= dict.fromkeys(after.variables, run)
    return {by.get(variable, "") for variable in list_away_from_rest(values, module.spec.rest)}
