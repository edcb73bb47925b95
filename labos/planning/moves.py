"""What may move on a floor, and what becomes of the floor then. Motions are tried out and taken back."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import msgspec

from labos.core.algebra import check_reaching, check_rooms, check_standing
from labos.core.binding import is_same
from labos.core.effects import NOWHERE, is_reported
from labos.core.ids import ModuleName, Owner, StationName
from labos.planning.floor import OTHERS, UNSETTLED, Actor, Counts, Floor, Loans, change_claim, is_closing
from labos.planning.paths import (
    JOINT,
    READY,
    Motion,
    door_key,
    find_kept_module,
    had_key,
    joint_claim,
    list_guard_keys,
    ready_key,
)


class Mover(msgspec.Struct, frozen=True, gc=False):
    """An actor on a floor: a store of motions (see ``core.algebra``) that says whether something is in the
    way, and not what."""

    floor: Floor
    actor: Actor

    def stock(self, what: Motion, stack: StationName) -> bool | None:
        return self.floor.stock.get(stack, 0) <= 0 or bool(self.floor.piles.get(stack)) or None

    def check_presence(self, what: Motion, place: StationName) -> bool | None:
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

    def check_hand(self, what: Motion) -> bool | None:
        return True if what.hand and self.floor.count.get(what.hand) else None

    def check_entry(self, what: Motion, place: StationName) -> bool | None:
        floor = self.floor
        module = floor.behind.get(place)
        if module is None:
            return None
        if not _open_to(floor, self.actor, module):
            return True
        claim = floor.claims.get(place, "")
        return bool(claim and not _may_claim(floor, self.actor, claim)) or None

    def check_room(self, what: Motion, place: StationName) -> bool | None:
        floor = self.floor
        more = what.room.count(place)
        return True if floor.count.get(place, 0) + more > floor.capacity.get(place, 0) else None


def may_move(floor: Floor, actor: Actor, motion: Motion) -> bool:
    """Whether the motion is possible on this floor."""
    if motion.back:
        return _may_go_back(floor, actor, motion)
    if is_closing(motion) and _is_left_out(floor, actor, motion):
        return True
    if motion.wants and not all(_is_set(floor, key, value) for key, value in motion.wants):
        return False
    if not motion.target:
        if motion.uses and not may_use(floor, actor, motion.uses):
            return False
        if motion.joint and not _are_all_ready(floor, actor, motion):
            return False
        asks = bool(motion.grabs) and not motion.recovers  # a recovery asks nobody
        if asks and not all(_may_grab(floor, actor, key, value) for key, value in motion.grabs):
            return False
        if motion.room and check_rooms(Mover(floor, actor), motion) is not None:
            return False
        return not motion.needs or all(find_usable_place(floor, actor, places) for places in motion.needs)
    mover = Mover(floor, actor)
    if motion.uses and not may_use(floor, actor, motion.uses):
        return False
    return check_standing(mover, motion) is None and check_reaching(mover, motion) is None


def may_use(floor: Floor, actor: Actor, module: ModuleName) -> bool:
    """Whether nobody else keeps a module."""
    return _open_to(floor, actor, module) and (
        module not in floor.claimed or _may_claim(floor, actor, module)
    )


def _are_all_ready(floor: Floor, actor: Actor, motion: Motion) -> bool:
    """Whether all who have labware in a module are ready for what an actor wants of it now, or it was done
    for the actor already, with another one."""
    if actor.name in floor.held.get(had_key(motion.joint), {}):
        return True
    ready, wish = floor.held.get(ready_key(motion.joint), {}), motion.wish
    inside = _list_inside(floor, motion.joint)
    return all(who == actor.name or (wish is not None and ready.get(who) == wish) for who in inside)


def _becomes_ready(actor: Actor, motion: Motion) -> bool:
    """Whether nothing else is left before the step for which a motion makes an actor ready. Behind a fork
    only the order that was planned is known."""
    left = [other for other in actor.motions[actor.done :] if other.for_step == motion.for_step]
    if motion not in left:
        return motion.is_last
    return all(other.step == motion.step for other in left)


def _list_inside(floor: Floor, module: ModuleName) -> list[str]:
    """The actors with labware in a module that does things for all of them at once."""
    claimed = floor.claimed.get(joint_claim(module), {})
    return [who for who, number in claimed.items() if number and who != OTHERS]


def _is_set(floor: Floor, key: str, wanted: Any) -> bool:
    """Whether a variable has a value, or may have it: what a device will report is not known yet."""
    value = floor.values.get(key)
    return value is not UNSETTLED and (is_reported(value) or is_same(value, wanted))


def find_usable_place(floor: Floor, actor: Actor, places: Iterable[StationName]) -> StationName:
    """The first of some places where labware stands that an actor may use: its own first; empty if there is
    none."""
    owners = [None, *actor.inputs]
    found = [(owners.index(owner), place) for place in places for owner in _list_usable(floor, actor, place)]
    return min(found, key=lambda pair: pair[0])[1] if found else NOWHERE


def _list_usable(floor: Floor, actor: Actor, place: StationName) -> list[Owner | None]:
    """Whose labware an actor would use at a place: its own (None), or out of a pool; empty if there is
    none."""
    if _has_own(floor, actor, place):
        return [None]
    pile = floor.piles.get(place)
    owners = [o for o in actor.inputs if floor.pools.get(o, {}).get(place) and not (pile and pile[-1] != o)]
    return [*owners[:1]]


def _is_left_out(floor: Floor, actor: Actor, motion: Motion) -> bool:
    """Whether a motion of a closing workflow is left out, as nothing stands there that has to be cleared away
    or that it works on."""
    owners = [o for o in actor.inputs if actor.name in actor.inputs and o in floor.pools]
    for place in motion.stands:
        there = actor.own.get(place, 0) + sum(floor.pools[owner].get(place, 0) for owner in owners)
        if there < motion.stands.count(place):
            return True
    return not all(find_usable_place(floor, actor, places) for places in motion.needs)


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
    return not claim or _may_claim(floor, actor, claim)


def _open_to(floor: Floor, actor: Actor, module: ModuleName) -> bool:
    held = floor.held
    if held:
        for key in list_guard_keys(module):
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
    module = find_kept_module(key)
    return not module or (
        _may_hold(floor, actor, door_key(module), None) and _may_claim(floor, actor, module)
    )


def _may_hold(floor: Floor, actor: Actor, key: str, value: Any) -> bool:
    """Whether nobody else holds it, or everybody wants the same."""
    if key.startswith(READY):
        return True
    holders = floor.held.get(key)
    return not holders or all(
        who == actor.name or (value is not None and other == value) for who, other in holders.items()
    )


def _find_pool(floor: Floor, actor: Actor, source: StationName) -> dict[StationName, int] | None:
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


def _may_claim(floor: Floor, actor: Actor, claim: str) -> bool:
    """Whether nobody but the actor, and what it may use, stands where a claim is held."""
    if claim.startswith(JOINT):
        return True
    holders = floor.claimed.get(claim)
    for who, number in holders.items() if holders else ():
        if not number or who == actor.name:
            continue
        if who != OTHERS or number > _count_usable(floor, actor, claim):
            return False
    return True


def _count_usable(floor: Floor, actor: Actor, claim: str) -> int:
    """How much of what an actor may use stands where a claim is held."""
    pools = [floor.pools.get(owner, {}) for owner in actor.inputs]
    return sum(n for pool in pools for place, n in pool.items() if floor.claims.get(place) == claim)


class ActorBefore(msgspec.Struct):
    """What an actor held before a motion (key, whether, value), how variables stood, what was lent to it,
    which plates have become its own (1), or are not any more (-1), out of which pool, and how much it left
    to whose pool where, and which of what lies on a stack that was. ``joined`` are the others who had it done
    with it: what they held for that, who, and the value."""

    keys: list[tuple[str, bool, Any]] = []
    values: list[tuple[str, Any]] = []
    lent: Loans = ()
    plates: list[tuple[StationName, Counts, int]] = []
    joined: list[tuple[str, str, Any]] = []
    given: list[tuple[StationName, Counts, int, list[int]]] = []


NOT_HELD = object()
"""In place of what somebody held, where that was nothing."""

Undo = tuple[Counts, str, Counts | None, Loans] | ActorBefore
"""From which count a motion took its labware, in whose name, from which pool it took over the plate whose
lid it carries, and what was lent to its actor before; for taking it back. Or what its actor held."""


def move(floor: Floor, actor: Actor, motion: Motion) -> Undo | None:
    """Carry a motion out on the floor; returns what ``take_back`` needs."""
    source, target = motion.source, motion.target
    if motion.back:
        _go_back(floor, actor, motion, 1)
        return {}, "", None, floor.lent.get(actor.name, ())
    if is_closing(motion) and _is_left_out(floor, actor, motion):
        return None
    if not target:
        return _hold(floor, actor, motion)
    counts: Counts = {}
    who, lent = "", floor.lent.get(actor.name, ())
    if motion.emptied:
        if motion.new:
            counts = floor.stock
        elif _has_own(floor, actor, source):
            counts, who = actor.own, actor.name
        else:
            pool = _find_pool(floor, actor, source)
            if pool is None:
                return None
            counts, who = pool, OTHERS
        counts[source] -= 1
        floor.count[source] -= 1
        if not motion.new:
            _change_pile(floor, source, "")
        change_claim(floor, source, who, -1)
        _keep_loan(floor, actor, source)
    if motion.filled:
        _change_pile(floor, target, actor.name)
        floor.count[target] = floor.count.get(target, 0) + 1
        if target not in floor.endless:
            actor.own[target] = actor.own.get(target, 0) + 1
            change_claim(floor, target, actor.name, 1)
    pool = None
    if motion.plate_at:
        pool = _take_over(floor, actor, motion.plate_at)
        _keep_loan(floor, actor, motion.plate_at)
    return counts, who, pool, lent


def take_back(floor: Floor, actor: Actor, motion: Motion, taken: Undo | None) -> None:
    """Undo the last motion of an actor."""
    if taken is None:
        return
    if isinstance(taken, ActorBefore):
        for key, who, value in reversed(taken.joined):
            if value is NOT_HELD:
                del floor.held[key][who]
            else:
                floor.held[key][who] = value
        for key, before, value in reversed(taken.keys):
            if before:
                floor.held.setdefault(key, {})[actor.name] = value
            else:
                del floor.held[key][actor.name]
        for key, value in reversed(taken.values):
            floor.values[key] = value
        for place, whose, sign in reversed(taken.plates):
            _change_owner(floor, actor, place, whose, -sign)
        for place, heir, number, left in taken.given:
            _give(floor, actor, place, heir, -number)
            for index in left:
                floor.piles[place][index] = actor.name
        if motion.needs or motion.returns:
            floor.lent[actor.name] = taken.lent
        return
    counts, who, pool, lent = taken
    if lent:
        floor.lent[actor.name] = lent
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
        _change_pile(floor, target, "")
        floor.count[target] -= 1
    if motion.emptied:
        if not motion.new:
            _change_pile(floor, source, _find_holder(floor, counts, who))
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
            _change_pile(floor, place, actor.name if change > 0 else "")


def _take_over(floor: Floor, actor: Actor, place: StationName) -> Counts | None:
    """A plate whose lid an actor carries belongs to the actor from then on; returns the pool that it came
    from."""
    pool = None if _has_own(floor, actor, place) else _find_pool(floor, actor, place)
    if pool is not None:
        _change_owner(floor, actor, place, pool, 1)
    return pool


def _change_owner(floor: Floor, actor: Actor, place: StationName, pool: Counts, sign: int) -> None:
    """One piece out of a pool becomes an actor's (1), or goes back (-1)."""
    pool[place] = pool.get(place, 0) - sign
    actor.own[place] = actor.own.get(place, 0) + sign
    change_claim(floor, place, OTHERS, -sign)
    change_claim(floor, place, actor.name, sign)
    pile = floor.piles.get(place)
    if pile:
        pile[-1] = actor.name if sign > 0 else _find_holder(floor, pool, OTHERS)


def _change_pile(floor: Floor, place: StationName, who: str) -> None:
    """Something of somebody's comes onto a stack; nobody's: what lies on top comes off it."""
    pile = floor.piles.get(place)
    if pile is not None and who:
        pile.append(who)
    elif pile:
        pile.pop()


def _find_holder(floor: Floor, counts: dict[StationName, int], who: str) -> str:
    """Whose labware was taken, if it was an actor's or out of somebody's pool."""
    return who if who != OTHERS else next(owner for owner, pool in floor.pools.items() if pool is counts)


def _has_own(floor: Floor, actor: Actor, source: StationName) -> bool:
    """Whether an actor takes what is its own; on a stack that is so if it lies on top."""
    pile = floor.piles.get(source)
    return pile[-1] == actor.name if pile else bool(actor.own.get(source))


def _hold(floor: Floor, actor: Actor, motion: Motion) -> ActorBefore | None:
    """Let an actor hold what a motion grabs, and have what it needs; let go of what it frees, and return what
    was lent."""
    if not motion.changes_anything:
        return None
    who, before = actor.name, ActorBefore(lent=floor.lent.get(actor.name, ()))
    is_early = motion.for_step is not None and not _becomes_ready(actor, motion)
    for key, value in motion.grabs if not is_early else ():
        holders = floor.held.setdefault(key, {})
        before.keys.append((key, who in holders, holders.get(who)))
        holders[who] = value
    if motion.joint:
        _join(floor, who, motion, before)
    for key in motion.frees:
        holders = floor.held.get(key, {})
        if who in holders:
            before.keys.append((key, True, holders.pop(who)))
    for key, value in motion.sets:
        before.values.append((key, floor.values.get(key)))
        floor.values[key] = value
    for places in motion.needs:
        _borrow(floor, actor, find_usable_place(floor, actor, places), before, keeps=motion.keeps)
    if motion.returns and before.lent:
        for place, owner in before.lent:
            pile, pool = floor.piles.get(place), floor.pools[owner]
            if pile and (pile[-1] != who or pile.count(who) > 1):
                continue  # of several on a stack it is not known here which one was lent
            _change_owner(floor, actor, place, pool, -1)
            before.plates.append((place, pool, -1))
        floor.lent[who] = ()
    if motion.heir:
        _leave_all(floor, actor, motion.heir, before)
    return before


def _join(floor: Floor, who: str, motion: Motion, before: ActorBefore) -> None:
    """What a module does for one, it does for all who have labware in it."""
    ready = floor.held.setdefault(ready_key(motion.joint), {})
    had = floor.held.setdefault(had_key(motion.joint), {})
    if who in had:
        before.joined.append((had_key(motion.joint), who, had.pop(who)))
        return
    for other in _list_inside(floor, motion.joint):
        if other != who:
            before.joined.append((ready_key(motion.joint), other, ready.pop(other)))
            before.joined.append((had_key(motion.joint), other, NOT_HELD))
            had[other] = motion.wish


def _leave_all(floor: Floor, actor: Actor, heir: Owner, before: ActorBefore) -> None:
    """All that an actor has belongs to somebody else."""
    pool = floor.pools.setdefault(heir, {})
    for place, number in actor.own.items():
        if number:
            _give(floor, actor, place, pool, number)
            left = [index for index, owner in enumerate(floor.piles.get(place, ())) if owner == actor.name]
            before.given.append((place, pool, number, left))
            for index in left:
                floor.piles[place][index] = heir


def _give(floor: Floor, actor: Actor, place: StationName, pool: Counts, number: int) -> None:
    """So much of an actor's labware at a place belongs to a pool from now on."""
    pool[place] = pool.get(place, 0) + number
    actor.own[place] -= number
    change_claim(floor, place, OTHERS, number)
    change_claim(floor, place, actor.name, -number)


def _borrow(floor: Floor, actor: Actor, place: StationName, before: ActorBefore, *, keeps: bool) -> None:
    """What stands at a place is an actor's from now on: until its end, or for good."""
    owner = next((owner for owner in _list_usable(floor, actor, place) if owner is not None), None)
    pool = _take_over(floor, actor, place) if owner is not None else None
    if keeps:
        _keep_loan(floor, actor, place)
    elif owner is not None:
        floor.lent[actor.name] = (*floor.lent.get(actor.name, ()), (place, owner))
    if pool is not None:
        before.plates.append((place, pool, 1))


def _keep_loan(floor: Floor, actor: Actor, place: StationName) -> None:
    """What was lent to an actor at a place stays its own."""
    lent = floor.lent.get(actor.name)
    if lent:
        floor.lent[actor.name] = tuple(loan for loan in lent if loan[0] != place)
