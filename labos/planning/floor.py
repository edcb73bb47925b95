"""The floor of a workcell as safety sees it: who has how much labware where, and what may move.

Everything in flight counts as arrived. Motions are tried out on the floor and taken back.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import msgspec

from labos.core.bench import Bench, Labware
from labos.core.effects import Move, Sets, Take
from labos.core.ids import SHARED, ActionId, ModuleName, Owner, RunId, StationName
from labos.core.runs import IN_FLIGHT, UNKNOWN
from labos.core.state import LabState
from labos.planning.paths import Motion

OTHERS = "others"
"""Holder of what belongs to no actor."""

CLOSING = -1
"""The step number of a closing workflow's motions behind a run."""


class Actor(msgspec.Struct):
    """Somebody with labware and a way to go. ``own`` counts its labware by station; of what the
    owners of its ``inputs`` have it may use what nobody has used before. ``stuck``: it cannot
    reach its end whatever the others do (paused, needs a dead module, has uncertain labware)."""

    name: str
    owners: tuple[Owner, ...]
    motions: tuple[Motion, ...]
    own: dict[StationName, int]
    inputs: tuple[Owner, ...] = ()
    stuck: bool = False
    done: int = 0


class Floor(msgspec.Struct):
    """How full the stations are, how much the stacks hold, who claims which deck, what users and
    everybody have where (``pools``), who holds which module by its door or lid (``shut``), and
    into which stations that door or lid leads (``doors``)."""

    count: dict[StationName, int] = {}
    capacity: dict[StationName, int] = {}
    stock: dict[StationName, int] = {}
    claims: dict[StationName, str] = {}
    claimed: dict[str, dict[str, int]] = {}
    endless: set[StationName] = set()
    pools: dict[Owner, dict[StationName, int]] = {}
    shut: dict[ModuleName, str] = {}
    doors: dict[StationName, ModuleName] = {}


def down(state: LabState, module: ModuleName) -> bool:
    """Whether a module needs a person or its device to come back before anybody can use it."""
    known = state.modules.by_name.get(module)
    return known is None or bool(known.out_of_service) or known.status in ("GONE", "ERROR")


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
    """Where labware will stand when the action that carries it has ended; empty if nowhere."""
    place = item.station
    for effect in bench.reserved.get(ActionId(item.moving), ()) if item.moving else ():
        if isinstance(effect, Move) and effect.labware == item.id:
            place = effect.target
    return StationName("") if place and bench.stations[place].spec.kind == "waste" else place


def arriving(state: LabState, run: RunId) -> list[StationName]:
    """Stations at which labware will appear that a run is taking off a stack right now."""
    active = state.runs.active.get(run)
    if active is None or not (IN_FLIGHT in active.steps or UNKNOWN in active.steps):
        return []
    return [
        effect.target
        for action in state.actions.open.values()
        if action.run == run
        for effect in action.effects
        if isinstance(effect, Take)
    ]


def lay_out(state: LabState, cell: str, actors: Sequence[Actor], *, hopeful: bool) -> Floor:
    """The floor of a workcell once everything in flight has ended. Labware whose place is not
    known takes up room wherever it may be; hopefully seen, an action of unknown outcome counts
    as done."""
    bench = state.bench
    prefix = f"{cell}/"
    floor = Floor(shut=_shut(state, prefix))
    for name, station in bench.stations.items():
        if not name.startswith(prefix):
            continue
        spec = station.spec
        floor.capacity[name] = spec.capacity
        floor.count[name] = len(station.stock)
        if spec.kind == "stack":
            floor.stock[name] = len(station.stock)
        elif spec.kind == "waste":
            floor.endless.add(name)
            floor.count[name] = station.level + station.expected
        if spec.claim:
            floor.claims[name] = spec.claim
        if (spec.claim or spec.access) and spec.module and state.modules.by_name[spec.module].spec.rest:
            floor.doors[name] = spec.module
    holders = {owner: actor.name for actor in actors for owner in actor.owners}
    for item in bench.labware.values():
        if item.maybe and not (hopeful and item.moving):
            for place in item.maybe:
                floor.count[place] = floor.count.get(place, 0) + 1
            continue
        place = destination(bench, item)
        if place.startswith(prefix):
            floor.count[place] = floor.count.get(place, 0) + 1
            _claim(floor, place, holders.get(item.owner, OTHERS), 1)
            if item.owner not in holders and (item.owner == SHARED or item.owner.startswith("user:")):
                pool = floor.pools.setdefault(item.owner, {})
                pool[place] = pool.get(place, 0) + 1
    for action in state.actions.open.values():
        for effect in action.effects:
            if isinstance(effect, Take) and effect.stack in floor.stock:
                floor.stock[effect.stack] -= 1
                floor.count[effect.stack] -= 1
                floor.count[effect.target] += 1
                _claim(floor, effect.target, str(action.run), 1)
    return floor


def _shut(state: LabState, prefix: str) -> dict[ModuleName, str]:
    """The modules that a run inside holds by a door or lid, once what is in flight has ended."""
    shut: dict[ModuleName, str] = {}
    for name, module in state.modules.by_name.items():
        if not module.spec.rest or not name.startswith(prefix):
            continue
        values, by = dict(module.variables), dict(module.set_by)
        for action in map(state.actions.open.__getitem__, module.in_flight):
            for effect in action.effects:
                if isinstance(effect, Sets) and effect.of == "module":
                    values[effect.variable], by[effect.variable] = effect.value, action.run
        for variable, value in module.spec.rest.items():
            if values.get(variable) != value and by.get(variable, "") in state.runs.active:
                shut[name] = by[variable]
    return shut


def may_move(floor: Floor, actor: Actor, motion: Motion) -> bool:
    """Whether the motion is possible on this floor."""
    source, target = motion.source, motion.target
    if motion.uses:
        return _open_to(floor, actor, ModuleName(motion.uses)) and _claimable(floor, actor, motion.uses)
    if motion.new:
        if floor.stock.get(source, 0) <= 0:
            return False
    elif not actor.own.get(source) and _pool(floor, actor, source) is None:
        return motion.step == CLOSING  # nothing to clear away there
    for door in (floor.doors.get(source), floor.doors.get(target)):
        if door is not None and not _open_to(floor, actor, door):
            return False
    if floor.count.get(target, 0) >= floor.capacity.get(target, 0):
        return False
    if motion.via and floor.count.get(motion.via, 0) >= floor.capacity.get(motion.via, 0):
        return False
    claim = floor.claims.get(target)
    return not claim or _claimable(floor, actor, claim)


def _open_to(floor: Floor, actor: Actor, module: ModuleName) -> bool:
    return floor.shut.get(module, actor.name) == actor.name


def _pool(floor: Floor, actor: Actor, source: StationName) -> dict[StationName, int] | None:
    """The counts of the labware of others that an actor may use at a station."""
    for owner in actor.inputs:
        pool = floor.pools.get(owner)
        if pool is not None and pool.get(source):
            return pool
    return None


def _claimable(floor: Floor, actor: Actor, claim: str) -> bool:
    """Whether nobody but the actor, and what it may use, stands where a claim is held."""
    for who, number in floor.claimed.get(claim, {}).items():
        if not number or who == actor.name:
            continue
        pools = [floor.pools.get(owner, {}) for owner in actor.inputs]
        usable = sum(n for pool in pools for place, n in pool.items() if floor.claims.get(place) == claim)
        if who != OTHERS or number > usable:
            return False
    return True


Taken = tuple[dict[StationName, int], str] | str
"""From which count a motion took its labware, and in whose name; or who held the module before;
for taking it back."""


def move(floor: Floor, actor: Actor, motion: Motion) -> Taken | None:
    """Carry a motion out on the floor; returns what ``take_back`` needs."""
    source, target = motion.source, motion.target
    if motion.uses:
        return _hold(floor, ModuleName(motion.uses), actor.name if motion.holds else "", motion)
    pool = None if motion.new or actor.own.get(source) else _pool(floor, actor, source)
    if motion.new:
        counts, who = floor.stock, ""
    elif actor.own.get(source):
        counts, who = actor.own, actor.name
    elif pool is not None:
        counts, who = pool, OTHERS
    else:
        return None
    counts[source] -= 1
    floor.count[source] -= 1
    _claim(floor, source, who, -1)
    floor.count[target] = floor.count.get(target, 0) + 1
    if target not in floor.endless:
        actor.own[target] = actor.own.get(target, 0) + 1
        _claim(floor, target, actor.name, 1)
    return counts, who


def take_back(floor: Floor, actor: Actor, motion: Motion, taken: Taken | None) -> None:
    """Undo the last motion of an actor."""
    if taken is None:
        return
    if isinstance(taken, str):
        _hold(floor, ModuleName(motion.uses), taken, motion)
        return
    counts, who = taken
    source, target = motion.source, motion.target
    if target not in floor.endless:
        actor.own[target] -= 1
        _claim(floor, target, actor.name, -1)
    floor.count[target] -= 1
    _claim(floor, source, who, 1)
    floor.count[source] += 1
    counts[source] += 1


def _hold(floor: Floor, module: ModuleName, who: str, motion: Motion) -> str | None:
    """Let somebody hold a module by its door or lid, or nobody; returns who did before."""
    if motion.holds is None:
        return None
    before = floor.shut.pop(module, "")
    if who:
        floor.shut[module] = who
    return before


def _claim(floor: Floor, station: StationName, who: str, change: int) -> None:
    claim = floor.claims.get(station)
    if claim and who:
        holders = floor.claimed.setdefault(claim, {})
        holders[who] = holders.get(who, 0) + change
