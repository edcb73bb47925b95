"""The floor of a workcell as safety sees it: who has how much labware where, and what may move.

Everything in flight counts as arrived. Motions are tried out on the floor and taken back.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import msgspec

from labos.core.algebra import reaching_refused, standing_refused
from labos.core.bench import Bench, Labware
from labos.core.binding import laid_up
from labos.core.effects import AnyEffect, Claims, Releases, Sets, carried, touched
from labos.core.ids import SHARED, ActionId, LabwareId, ModuleName, Owner, RunId, StationName
from labos.core.leaving import will_leave
from labos.core.model import Plan
from labos.core.modules import Module
from labos.core.runs import IN_FLIGHT, PENDING, SETTLED, SKIPPED, UNKNOWN, RunState, RunStatus
from labos.core.state import LabState
from labos.planning.paths import END, Motion, door_key, guards, hold_key, kept_by, setpoint_key

OTHERS = "others"
"""Holder of what belongs to no actor."""

CLOSING = -4
"""The number of the first step of a closing workflow behind a run. Its other steps count down from there, and
its end has the number above."""


class Branch(msgspec.Struct, frozen=True):
    """One way that an actor may have to go from a fork to its end; on one that ``fails`` its run does not
    come to the end of its workflow."""

    motions: tuple[Motion, ...]
    fails: bool = False


class Actor(msgspec.Struct):
    """Somebody with labware and a way to go. ``own`` counts its labware by station; of what the
    owners of its ``inputs`` have it may use what nobody has used before. ``stuck``: it cannot
    reach its end whatever the others do (paused, needs a dead module, has uncertain labware).
    ``parks``: its experiment is open; only its application knows when it closes. Behind its ``motions``
    the way may fork (``forks``); ``done`` counts the motions, and the forks as one. ``kept``: what must stay
    free for what it has in flight, as that may fail."""

    name: str
    owners: tuple[Owner, ...]
    motions: tuple[Motion, ...]
    own: dict[StationName, int]
    inputs: tuple[Owner, ...] = ()
    stuck: bool = False
    done: int = 0
    parks: bool = False
    forks: tuple[Branch, ...] = ()
    kept: tuple[Motion, ...] = ()

    @property
    def length(self) -> int:
        """What it has to do before it is at its end."""
        return len(self.motions) + bool(self.forks)


class Floor(msgspec.Struct):
    """How full the stations are, how much the stacks hold, who claims which deck, what users and
    everybody have where (``pools``), who holds what beside (``held``: key → actor → value, see
    ``paths``), whose doors and decks stations are behind (``behind``), whose hands they are (``arms``),
    and what lies on stacks (``piles``, bottom to top: actors, or owners who are none): of them only the
    topmost can be had."""

    count: dict[StationName, int] = {}
    capacity: dict[StationName, int] = {}
    stock: dict[StationName, int] = {}
    claims: dict[StationName, str] = {}
    claimed: dict[str, dict[str, int]] = {}
    endless: set[StationName] = set()
    pools: dict[Owner, dict[StationName, int]] = {}
    held: dict[str, dict[str, Any]] = {}
    behind: dict[StationName, ModuleName] = {}
    arms: dict[StationName, ModuleName] = {}
    piles: dict[StationName, list[str]] = {}


def is_closing(motion: Motion) -> bool:
    """Whether a motion belongs to the closing workflow behind a run."""
    return motion.step <= CLOSING - END


def down(state: LabState, module: ModuleName, *, recovered: bool = False) -> bool:
    """Whether a module needs a person or its device to come back before anybody can use it; to
    be ``recovered`` first, an error is no hindrance."""
    known = state.modules.by_name.get(module)
    return known is None or module in state.lab.paused or laid_up(known, recovers=recovered) is not None


def standing(state: LabState, owners: Iterable[Owner]) -> tuple[dict[StationName, int], bool]:
    """Where the owners' labware will stand once what is in flight has ended, and whether some of
    it is lost."""
    places: dict[StationName, int] = {}
    lost = False
    for owner in owners:
        for item in state.bench.owned(owner):
            lost = lost or bool(item.maybe)
            place = destination(state.bench, item)
            if place:
                places[place] = places.get(place, 0) + 1
        if owner.startswith("run:"):
            for target in arriving(state, RunId(owner[4:])):
                places[target] = places.get(target, 0) + 1
    return places, lost


def destination(bench: Bench, item: Labware) -> StationName:
    """Where labware will stand when the action that carries it has ended, as plans name it; empty if
    nowhere."""
    place = item.station
    for what in carried(bench.reserved.get(ActionId(item.moving), ())) if item.moving else ():
        if what.labware == item.id:
            place = what.filled
    return StationName("") if place and bench.stations[place].spec.kind == "waste" else bench.planned(place)


def arriving(state: LabState, run: RunId) -> list[StationName]:
    """Stations at which labware will appear that a run is taking off a stack right now."""
    active = state.runs.active.get(run)
    if active is None or not active.has(IN_FLIGHT, UNKNOWN):
        return []
    return [
        state.bench.planned(what.target)
        for action in state.actions.within(state.runs.plan_of(active).workcell)
        if action.run == run
        for what in carried(action.effects)
        if what.stock
    ]


def labware_in(state: LabState, cell: str) -> list[Labware]:
    """Labware that stands in a workcell, that is carried there, and all of which it is not known where it
    is. Lids are with their plates."""
    bench = state.bench
    names: dict[LabwareId, bool] = {}
    for place in bench.in_cell.get(cell, ()):
        standing_there = bench.stations[place].labware
        if standing_there:
            names.update(dict.fromkeys(standing_there, True))
    for action in state.actions.within(cell):
        if action.effects:
            names.update(dict.fromkeys(touched(action.effects), True))
    names.update(bench.lost)
    return [bench.labware[name] for name in names if name in bench.labware]


def lay_out(state: LabState, cell: str, actors: Sequence[Actor], *, hopeful: bool) -> Floor:
    """The floor of a workcell once everything in flight has ended. Labware whose place is not
    known takes up room wherever it may be; hopefully seen, an action of unknown outcome counts
    as done. All shelves of a hotel are one place here: what can go onto one can go onto any."""
    bench = state.bench
    prefix = f"{cell}/"
    floor = Floor(held=_held(state, cell))
    for name in bench.in_cell.get(cell, ()):
        station = bench.stations[name]
        spec = station.spec
        if spec.hotel:
            continue
        floor.capacity[name] = spec.capacity
        floor.count[name] = len(station.stock)
        if spec.kind == "stack":
            floor.stock[name] = len(station.stock)
            floor.piles[name] = []
        elif spec.kind == "waste":
            floor.endless.add(name)
            floor.count[name] = station.count
        elif spec.kind == "gripper":
            floor.arms[name] = spec.module
        if spec.claim:
            floor.claims[name] = spec.claim
        if (spec.claim or spec.access) and spec.module:
            floor.behind[name] = spec.module
    holders = {owner: actor.name for actor in actors for owner in actor.owners}
    coming: list[tuple[StationName, str]] = []
    for item in labware_in(state, cell):
        if item.maybe and not (hopeful and item.moving):
            for place in map(bench.planned, item.maybe):
                floor.count[place] = floor.count.get(place, 0) + 1
                change_claim(floor, place, holders.get(item.owner, OTHERS), 1)
            continue
        place = destination(bench, item)
        if place.startswith(prefix):
            floor.count[place] = floor.count.get(place, 0) + 1
            if place in floor.piles and place != item.station:
                coming.append((place, holders.get(item.owner, item.owner)))
            change_claim(floor, place, holders.get(item.owner, OTHERS), 1)
            if item.owner not in holders and (item.owner == SHARED or item.owner.startswith("user:")):
                pool = floor.pools.setdefault(item.owner, {})
                pool[place] = pool.get(place, 0) + 1
    for place, pile in floor.piles.items():
        for labware in bench.stations[place].labware:
            standing_there = bench.labware[labware]
            if destination(bench, standing_there) == place:
                pile.append(holders.get(standing_there.owner, standing_there.owner))
    for place, who in coming:
        floor.piles[place].append(who)
    for action in state.actions.within(cell):
        for what in carried(action.effects):
            if what.stock in floor.stock:
                target = bench.planned(what.target)
                floor.stock[what.stock] -= 1
                floor.count[what.stock] -= 1
                floor.count[target] += 1
                _pile(floor, target, str(action.run))
                change_claim(floor, target, str(action.run), 1)
    for actor in actors:
        keep(floor, actor, actor.kept)
    return floor


def keep(floor: Floor, actor: Actor, kept: Iterable[Motion]) -> None:
    """Keep what an actor needs if something that it has in flight fails."""
    for motion in kept:
        if motion.source:
            _go_back(floor, actor, motion, -1)
        else:
            move(floor, actor, motion)


def _held(state: LabState, cell: str) -> dict[str, dict[str, Any]]:
    """What runs inside hold by doors, setpoints and their plans' word, once what is in flight has
    ended."""
    active = state.runs.inside(cell)
    staying = {str(run.id) for run in active if not _about_to_end(state.runs.plan_of(run), run)}
    held: dict[str, dict[str, Any]] = {}
    for name, module in state.modules.within(cell):
        flying = [
            (str(state.actions.open[action].run), effect)
            for action in module.in_flight
            for effect in state.actions.open[action].effects
        ]
        held[door_key(name)] = dict.fromkeys(_by_doors(module, flying) & staying)
        for setpoint, now in module.setpoints.items():
            held[setpoint_key(name, setpoint)] = {who: now.value for who in now.holders if who in staying}
        for run, effect in flying:
            if isinstance(effect, Claims) and run in staying:
                held.setdefault(setpoint_key(name, effect.setpoint), {})[run] = effect.value
            elif isinstance(effect, Releases):
                held.get(setpoint_key(name, effect.setpoint), {}).pop(run, None)
        holders = [state.runs.active[holder] for holder in state.runs.holders.get(name, ())]
        held[hold_key(name)] = {
            str(run.id): None for run in holders if _will_hold(state.runs.plan_of(run), run, name)
        }
    return {key: holders for key, holders in held.items() if holders}


def _about_to_end(plan: Plan, run: RunState) -> bool:
    """Whether a run has nothing left to start, also if what it has in flight fails; its end lets go of all
    it holds."""
    ends = run.status == RunStatus.CANCELLING and not will_leave(plan, run)
    policies = [
        step.on_error for step, at in zip(plan.steps, run.steps, strict=True) if at.status == IN_FLIGHT
    ]
    recovers = any(policy is not None and policy.do == "run" for policy in policies)
    return ends or (not recovers and all(step.status in (IN_FLIGHT, *SETTLED) for step in run.steps))


def _will_hold(plan: Plan, run: RunState, module: ModuleName) -> bool:
    return any(
        hold.module == module
        and run.steps[hold.first].status not in (PENDING, SKIPPED)
        and run.steps[hold.last].status not in (IN_FLIGHT, *SETTLED)
        for hold in plan.holds
    )


def _by_doors(module: Module, flying: list[tuple[str, AnyEffect]]) -> set[str]:
    """Who will have left a door or lid away from rest."""
    if not module.spec.rest:
        return set()
    values = module.values
    by = {name: variable.by for name, variable in module.variables.items()}
    for run, effect in flying:
        if isinstance(effect, Sets) and effect.of == "module":
            values[effect.variable], by[effect.variable] = effect.value, run
    return {
        by.get(variable, "") for variable, value in module.spec.rest.items() if values.get(variable) != value
    }


class Mover(msgspec.Struct, frozen=True, gc=False):
    """An actor on a floor: a store of motions (see ``core.algebra``) that says whether something is in the
    way, and not what."""

    floor: Floor
    actor: Actor

    def stock(self, what: Motion, stack: StationName) -> bool | None:
        return self.floor.stock.get(stack, 0) <= 0 or bool(self.floor.piles.get(stack)) or None

    def stands(self, what: Motion, place: StationName) -> bool | None:
        floor, actor = self.floor, self.actor
        number = what.stands.count(place)
        if place in floor.piles:
            pile = floor.piles[place]
            top = pile[-number:]
            return len(top) < number or not all(o == actor.name or o in actor.inputs for o in top) or None
        there = actor.own.get(place, 0)
        if there >= number:
            return None
        there += sum(floor.pools[o].get(place, 0) for o in actor.inputs if o in floor.pools)
        return True if there < number else None

    def hand(self, what: Motion) -> bool | None:
        return True if what.hand and self.floor.count.get(what.hand) else None

    def entry(self, what: Motion, place: StationName) -> bool | None:
        floor = self.floor
        module = floor.behind.get(place)
        if module is None:
            return None
        if not _open_to(floor, self.actor, module):
            return True
        claim = floor.claims.get(place, "")
        return bool(claim and not _claimable(floor, self.actor, claim)) or None

    def room(self, what: Motion, place: StationName) -> bool | None:
        floor = self.floor
        more = what.room.count(place)
        return True if floor.count.get(place, 0) + more > floor.capacity.get(place, 0) else None


def may_move(floor: Floor, actor: Actor, motion: Motion) -> bool:
    """Whether the motion is possible on this floor."""
    if motion.back:
        return _may_go_back(floor, actor, motion)
    if not motion.target:
        if motion.uses and not may_use(floor, actor, motion.uses):
            return False
        return not motion.grabs or all(_may_grab(floor, actor, key, value) for key, value in motion.grabs)
    mover = Mover(floor, actor)
    if motion.step <= CLOSING - END and _nothing_to_clear(mover, motion):
        return True
    if motion.uses and not may_use(floor, actor, motion.uses):
        return False
    return standing_refused(mover, motion) is None and reaching_refused(mover, motion) is None


def may_use(floor: Floor, actor: Actor, module: ModuleName) -> bool:
    """Whether nobody else keeps a module."""
    return _open_to(floor, actor, module) and (
        module not in floor.claimed or _claimable(floor, actor, module)
    )


def _nothing_to_clear(mover: Mover, motion: Motion) -> bool:
    """Whether a motion of a closing workflow is left out, as nothing stands there."""
    for place in motion.stands:  # noqa: SIM110  (asked too often for a generator)
        if mover.stands(motion, place):
            return True
    return False


def _may_go_back(floor: Floor, actor: Actor, motion: Motion) -> bool:
    """Whether things can be as they are once it is known how something in flight ended."""
    if motion.target:
        return motion.new or _has_room(floor, actor, motion)
    pile = floor.piles.get(motion.source)
    return pile is None or pile[-1:] == [actor.name]


def _has_room(floor: Floor, actor: Actor, motion: Motion) -> bool:
    """Whether its target has room for what is moved, and is nobody else's deck."""
    target = motion.target
    if floor.count.get(target, 0) >= floor.capacity.get(target, 0):
        return False
    claim = floor.claims.get(target)
    return not claim or _claimable(floor, actor, claim)


def _open_to(floor: Floor, actor: Actor, module: ModuleName) -> bool:
    held = floor.held
    if held:
        for key in guards(module):
            if not _holds_alone(actor, held.get(key)):
                return False
    return True


def _holds_alone(actor: Actor, holders: dict[str, Any] | None) -> bool:
    """Whether nobody else is among the holders of something."""
    return not holders or (len(holders) == 1 and actor.name in holders)


def _may_grab(floor: Floor, actor: Actor, key: str, value: Any) -> bool:
    """Whether an actor may come to hold something. A module is kept by a plan's word only once nobody else
    has labware in it or has left its door: who has would not get at it any more."""
    if not _may_hold(floor, actor, key, value):
        return False
    module = kept_by(key)
    return not module or (
        _may_hold(floor, actor, door_key(module), None) and _claimable(floor, actor, module)
    )


def _may_hold(floor: Floor, actor: Actor, key: str, value: Any) -> bool:
    """Whether nobody else holds it, or everybody wants the same."""
    holders = floor.held.get(key)
    return not holders or all(
        who == actor.name or (value is not None and other == value) for who, other in holders.items()
    )


def _pool(floor: Floor, actor: Actor, source: StationName) -> dict[StationName, int] | None:
    """The counts of the labware of others that an actor may use at a station; on a stack, of what lies
    on top."""
    pile = floor.piles.get(source)
    for owner in actor.inputs:
        if pile and owner != pile[-1]:
            continue
        pool = floor.pools.get(owner)
        if pool is not None and pool.get(source):
            return pool
    return None


def _claimable(floor: Floor, actor: Actor, claim: str) -> bool:
    """Whether nobody but the actor, and what it may use, stands where a claim is held."""
    holders = floor.claimed.get(claim)
    for who, number in holders.items() if holders else ():
        if not number or who == actor.name:
            continue
        if who != OTHERS or number > _usable(floor, actor, claim):
            return False
    return True


def _usable(floor: Floor, actor: Actor, claim: str) -> int:
    """How much of what an actor may use stands where a claim is held."""
    pools = [floor.pools.get(owner, {}) for owner in actor.inputs]
    return sum(n for pool in pools for place, n in pool.items() if floor.claims.get(place) == claim)


Counts = dict[StationName, int]

Taken = tuple[Counts, str, Counts | None] | list[tuple[str, bool, Any]]
"""From which count a motion took its labware, in whose name, and from which pool it took over the plate whose
lid it carries; or what its actor held before (key, whether, value); for taking it back."""


def move(floor: Floor, actor: Actor, motion: Motion) -> Taken | None:
    """Carry a motion out on the floor; returns what ``take_back`` needs."""
    source, target = motion.source, motion.target
    if motion.back:
        _go_back(floor, actor, motion, 1)
        return {}, "", None
    if not target:
        return _hold(floor, actor.name, motion)
    if motion.step <= CLOSING - END and _nothing_to_clear(Mover(floor, actor), motion):
        return None
    counts: Counts = {}
    who = ""
    if motion.emptied:
        if motion.new:
            counts = floor.stock
        elif _has_own(floor, actor, source):
            counts, who = actor.own, actor.name
        else:
            pool = _pool(floor, actor, source)
            if pool is None:
                return None
            counts, who = pool, OTHERS
        counts[source] -= 1
        floor.count[source] -= 1
        if not motion.new:
            _pile(floor, source, "")
        change_claim(floor, source, who, -1)
    if motion.filled:
        _pile(floor, target, actor.name)
        floor.count[target] = floor.count.get(target, 0) + 1
        if target not in floor.endless:
            actor.own[target] = actor.own.get(target, 0) + 1
            change_claim(floor, target, actor.name, 1)
    return counts, who, _take_over(floor, actor, motion.plate_at) if motion.plate_at else None


def take_back(floor: Floor, actor: Actor, motion: Motion, taken: Taken | None) -> None:
    """Undo the last motion of an actor."""
    if taken is None:
        return
    if isinstance(taken, list):
        for key, before, value in reversed(taken):
            if before:
                floor.held.setdefault(key, {})[actor.name] = value
            else:
                del floor.held[key][actor.name]
        return
    counts, who, pool = taken
    source, target = motion.source, motion.target
    if pool is not None:
        _change_owner(floor, actor, motion.plate_at, pool, -1)
    if motion.back:
        _go_back(floor, actor, motion, -1)
        return
    if motion.filled:
        if target not in floor.endless:
            actor.own[target] -= 1
            change_claim(floor, target, actor.name, -1)
        _pile(floor, target, "")
        floor.count[target] -= 1
    if motion.emptied:
        if not motion.new:
            _pile(floor, source, _holder(floor, counts, who))
        change_claim(floor, source, who, 1)
        floor.count[source] += 1
        counts[source] += 1


def _go_back(floor: Floor, actor: Actor, motion: Motion, sign: int) -> None:
    """Make things be as it is known now (1), or take that back (-1)."""
    for place, change in ((motion.source, -sign), (motion.target, sign)):
        if not place:
            continue
        floor.count[place] = floor.count.get(place, 0) + change
        if motion.new and place == motion.target:
            floor.stock[place] = floor.stock.get(place, 0) + change
        elif place not in floor.endless:
            if motion.target:
                actor.own[place] = actor.own.get(place, 0) + change
            change_claim(floor, place, actor.name, change)
            _pile(floor, place, actor.name if change > 0 else "")


def _take_over(floor: Floor, actor: Actor, place: StationName) -> Counts | None:
    """A plate whose lid an actor carries is its own from then on; returns out of which pool it came."""
    pool = None if _has_own(floor, actor, place) else _pool(floor, actor, place)
    if pool is not None:
        _change_owner(floor, actor, place, pool, 1)
    return pool


def _change_owner(floor: Floor, actor: Actor, place: StationName, pool: Counts, sign: int) -> None:
    """One piece out of a pool becomes an actor's (1), or goes back (-1)."""
    pool[place] -= sign
    actor.own[place] = actor.own.get(place, 0) + sign
    change_claim(floor, place, OTHERS, -sign)
    change_claim(floor, place, actor.name, sign)
    pile = floor.piles.get(place)
    if pile:
        pile[-1] = actor.name if sign > 0 else _holder(floor, pool, OTHERS)


def _pile(floor: Floor, place: StationName, who: str) -> None:
    """Something of somebody's comes onto a stack; nobody's: what lies on top comes off it."""
    pile = floor.piles.get(place)
    if pile is not None and who:
        pile.append(who)
    elif pile:
        pile.pop()


def _holder(floor: Floor, counts: dict[StationName, int], who: str) -> str:
    """Whose labware was taken, if it was an actor's or out of somebody's pool."""
    return who if who != OTHERS else next(owner for owner, pool in floor.pools.items() if pool is counts)


def _has_own(floor: Floor, actor: Actor, source: StationName) -> bool:
    """Whether an actor takes what is its own; on a stack that is so if it lies on top."""
    pile = floor.piles.get(source)
    return pile[-1] == actor.name if pile else bool(actor.own.get(source))


def _hold(floor: Floor, who: str, motion: Motion) -> list[tuple[str, bool, Any]] | None:
    """Let an actor hold what a motion grabs, and let go of what it frees."""
    if not motion.grabs and not motion.frees:
        return None
    before: list[tuple[str, bool, Any]] = []
    for key, value in motion.grabs:
        holders = floor.held.setdefault(key, {})
        before.append((key, who in holders, holders.get(who)))
        holders[who] = value
    for key in motion.frees:
        holders = floor.held.get(key, {})
        if who in holders:
            before.append((key, True, holders.pop(who)))
    return before


def change_claim(floor: Floor, station: StationName, who: str, change: int) -> None:
    """So much more labware of somebody stands where it claims a deck."""
    claim = floor.claims.get(station)
    if claim and who:
        holders = floor.claimed.setdefault(claim, {})
        holders[who] = holders.get(who, 0) + change
