"""Which motions are possible on a floor, and how they change it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec

from labos.core.algebra import check_reaching, check_rooms, check_standing
from labos.core.binding import is_same
from labos.core.effects import NOWHERE, is_reported
from labos.core.ids import ModuleName, Owner, StationName
from labos.planning.floor import OTHERS, UNSETTLED, Actor, Floor, change_claim
from labos.planning.held import (
    done_key,
    door_key,
    find_kept_module,
    joint_claim,
    list_guard_keys,
    may_be_shared,
    ready_key,
)
from labos.planning.paths import ClosingStep, Motion


class Mover(msgspec.Struct, frozen=True, gc=False):
    """An actor on a floor: a store of motions (see ``core.algebra``). A check returns True if something is in
    the way, and None if not. It does not say what is in the way."""

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
        return True if there + _count_usable_at(floor, actor, place) < number else None

    def check_hand(self, what: Motion) -> bool | None:
        return True if what.hand and self.floor.count.get(what.hand) else None

    def check_entry(self, what: Motion, place: StationName) -> bool | None:
        floor = self.floor
        module = floor.behind.get(place)
        if module is None:
            return None
        if floor.held and not _open_to(floor, self.actor, module):
            return True
        claim = floor.claims.get(place)
        return True if claim and not _may_claim(floor, self.actor, claim) else None

    def check_room(self, what: Motion, place: StationName) -> bool | None:
        floor = self.floor
        more = what.room.count(place)
        return True if floor.count.get(place, 0) + more > floor.capacity.get(place, 0) else None


def may_move(floor: Floor, actor: Actor, motion: Motion) -> bool:
    """Whether a motion is possible on this floor. A search spends most of its time here and in ``move``, so
    both call few functions."""
    if motion.back:
        return _may_go_back(floor, actor, motion)
    if type(motion.step) is ClosingStep and _is_left_out(floor, actor, motion):
        return True
    if motion.wants and not all(_is_set(floor, key, value) for key, value in motion.wants):
        return False
    if not motion.target:
        if motion.uses and not may_use(floor, actor, motion.uses):
            return False
        if motion.joint and not _are_all_ready(floor, actor, motion):
            return False
        asks = bool(motion.grabs) and not motion.recovers  # a recovery ignores holders
        if asks and not all(_may_grab(floor, actor, key, value) for key, value in motion.grabs):
            return False
        if motion.room and check_rooms(Mover(floor, actor), motion) is not None:
            return False
        return not motion.needs or all(find_usable_place(floor, actor, places) for places in motion.needs)
    mover = Mover(floor, actor)
    if motion.uses and not may_use(floor, actor, motion.uses):
        return False
    # Entries are checked first: they are what other actors block most often.
    return check_reaching(mover, motion) is None and check_standing(mover, motion) is None


def may_use(floor: Floor, actor: Actor, module: ModuleName) -> bool:
    """Whether no other actor keeps a module from this one."""
    return _open_to(floor, actor, module) and (
        module not in floor.claimed or _may_claim(floor, actor, module)
    )


def _are_all_ready(floor: Floor, actor: Actor, motion: Motion) -> bool:
    """Whether all actors with labware in a module are ready for the action that this actor wants now. Also
    True if the module has done it for this actor already, together with another one."""
    if actor.name in floor.held.get(done_key(motion.joint), {}):
        return True
    ready, wish = floor.held.get(ready_key(motion.joint), {}), motion.wish
    inside = _list_inside(floor, motion.joint)
    return all(who == actor.name or (wish is not None and ready.get(who) == wish) for who in inside)


def _becomes_ready(actor: Actor, motion: Motion) -> bool:
    """Whether no other step is left before the step for which a motion makes an actor ready. Behind a fork
    only the planned order is known."""
    left = [other for other in actor.motions[actor.done :] if other.for_step == motion.for_step]
    if motion not in left:
        return motion.is_last
    return all(other.step == motion.step for other in left)


def _list_inside(floor: Floor, module: ModuleName) -> list[str]:
    """The actors with labware in a module that does an action for all of them at once."""
    claimed = floor.claimed.get(joint_claim(module), {})
    return [who for who, number in claimed.items() if number and who != OTHERS]


def _is_set(floor: Floor, key: str, wanted: Any) -> bool:
    """Whether a variable has the wanted value. True if a device will report the value, because the report is
    not known yet; False if branches leave different values."""
    value = floor.values.get(key)
    return value is not UNSETTLED and (is_reported(value) or is_same(value, wanted))


def find_usable_place(floor: Floor, actor: Actor, places: Sequence[StationName]) -> StationName:
    """The place, out of some, with labware that an actor may use. The first place with its own labware comes
    first, then the order of its inputs counts. Empty if there is none."""
    for place in places:
        if _has_own(floor, actor, place):
            return place
    owners = [(place, _find_lender(floor, actor, place)) for place in places]
    found = [(actor.inputs.index(owner), place) for place, owner in owners if owner is not None]
    return min(found, key=lambda pair: pair[0])[1] if found else NOWHERE


def _find_lender(floor: Floor, actor: Actor, place: StationName) -> Owner | None:
    """The owner of labware at a place that an actor may use, from the pools of its inputs; None if there is
    none. On a stack only the topmost piece counts."""
    pile = floor.piles.get(place)
    for owner in actor.inputs:
        if pile and owner != pile[-1]:
            continue
        if floor.pools.get(owner, {}).get(place):
            return owner
    return None


def _is_left_out(floor: Floor, actor: Actor, motion: Motion) -> bool:
    """Whether a motion of a closing workflow is left out, because the labware that it clears away or works on
    is not there."""
    for place in motion.stands:
        missing = motion.stands.count(place) - actor.own.get(place, 0)
        if missing > 0 and (
            actor.name not in actor.inputs or missing > _count_usable_at(floor, actor, place)
        ):
            return True
    return bool(motion.needs) and any(not find_usable_place(floor, actor, p) for p in motion.needs)


def _count_usable_at(floor: Floor, actor: Actor, place: StationName) -> int:
    """The number of pieces at a place that an actor may use, from the pools of its inputs."""
    found = 0
    for owner in actor.inputs:
        pool = floor.pools.get(owner)
        if pool:
            found += pool.get(place, 0)
    return found


def _may_go_back(floor: Floor, actor: Actor, motion: Motion) -> bool:
    """Whether a motion is possible that corrects the floor after the outcome of a step in flight is known."""
    if motion.target:
        return motion.new or _has_room(floor, actor, motion)
    pile = floor.piles.get(motion.source)
    return pile is None or pile[-1:] == (actor.name,)


def _has_room(floor: Floor, actor: Actor, motion: Motion) -> bool:
    """Whether the target has room for the labware, and is not on a deck that another actor claims."""
    target = motion.target
    if floor.count.get(target, 0) >= floor.capacity.get(target, 0):
        return False
    claim = floor.claims.get(target)
    return not claim or _may_claim(floor, actor, claim)


def _open_to(floor: Floor, actor: Actor, module: ModuleName) -> bool:
    """Whether no other actor keeps a module by a door away from rest or by a hold."""
    for key in list_guard_keys(module):
        holders = floor.held.get(key)
        if holders and (len(holders) > 1 or actor.name not in holders):
            return False
    return True


def _may_grab(floor: Floor, actor: Actor, key: str, value: Any) -> bool:
    """Whether an actor may begin to hold something. A plan's hold on a module begins only if no other actor
    has labware in it or has left its door away from rest: that actor could no longer reach into it."""
    if not _may_hold(floor, actor, key, value):
        return False
    module = find_kept_module(key)
    return not module or (
        _may_hold(floor, actor, door_key(module), None) and _may_claim(floor, actor, module)
    )


def _may_hold(floor: Floor, actor: Actor, key: str, value: Any) -> bool:
    """Whether no other actor holds this, or all holders want the same value (None: it cannot be shared).
    Also True if several runs may hold it for different things."""
    if may_be_shared(key):
        return True
    holders = floor.held.get(key)
    return not holders or all(
        who == actor.name or (value is not None and other == value) for who, other in holders.items()
    )


def _may_claim(floor: Floor, actor: Actor, claim: str) -> bool:
    """Whether all labware at the stations of a claim belongs to the actor, or is labware that it may use.
    Also True if several runs may share the claim."""
    holders = floor.claimed.get(claim)
    for who, number in holders.items() if holders else ():
        if not number or who == actor.name:
            continue
        if who != OTHERS or number > _count_usable(floor, actor, claim):
            return may_be_shared(claim)
    return True


def _count_usable(floor: Floor, actor: Actor, claim: str) -> int:
    """The number of pieces at the stations of a claim that an actor may use, from the pools of its inputs."""
    pools = [floor.pools.get(owner, {}) for owner in actor.inputs]
    return sum(n for pool in pools for place, n in pool.items() if floor.claims.get(place) == claim)


def move(floor: Floor, actor: Actor, motion: Motion) -> None:
    """Carry a motion out on the floor."""
    if motion.back:
        go_back(floor, actor, motion, 1)
    elif type(motion.step) is ClosingStep and _is_left_out(floor, actor, motion):
        return
    elif motion.target:
        _carry(floor, actor, motion)
    elif motion.changes_anything:
        _hold(floor, actor, motion)


def _carry(floor: Floor, actor: Actor, motion: Motion) -> None:
    source, target = motion.source, motion.target
    if motion.emptied:
        counts, who = floor.stock, ""
        if not motion.new:
            counts, who = actor.own, actor.name
            if not _has_own(floor, actor, source):
                lender = _find_lender(floor, actor, source)
                if lender is None:
                    return
                counts, who = floor.pools[lender], OTHERS
            if source in floor.piles:
                change_pile(floor, source, "")
        floor.add(counts, source, -1)
        floor.add(floor.count, source, -1)
        change_claim(floor, source, who, -1)
        if floor.lent:
            _keep_loan(floor, actor, source)
    if motion.filled:
        if target in floor.piles:
            change_pile(floor, target, actor.name)
        floor.add(floor.count, target, 1)
        if target not in floor.endless:
            floor.add(actor.own, target, 1)
            change_claim(floor, target, actor.name, 1)
    if motion.plate_at:
        _take_over(floor, actor, motion.plate_at)
        _keep_loan(floor, actor, motion.plate_at)


def go_back(floor: Floor, actor: Actor, motion: Motion, sign: int) -> None:
    """Take labware away from the source of a motion and put it at the target (``sign`` 1), or undo this (-1).
    Without a target, only the room at the source changes."""
    for place, change in ((motion.source, -sign), (motion.target, sign)):
        if not place:
            continue
        floor.add(floor.count, place, change)
        if motion.new and place == motion.target:
            floor.add(floor.stock, place, change)
        elif place not in floor.endless:
            if motion.target:
                floor.add(actor.own, place, change)
            change_claim(floor, place, actor.name, change)
            change_pile(floor, place, actor.name if change > 0 else "")


def _take_over(floor: Floor, actor: Actor, place: StationName) -> Owner | None:
    """Give the labware at a place to an actor, for example the plate whose lid it carries. Returns the owner
    from whose pool it comes; None if the actor has labware of its own there, or if there is none to use."""
    lender = None if _has_own(floor, actor, place) else _find_lender(floor, actor, place)
    if lender is not None:
        _change_owner(floor, actor, place, lender, 1)
    return lender


def _change_owner(floor: Floor, actor: Actor, place: StationName, lender: Owner, sign: int) -> None:
    """Move one piece from the pool of a ``lender`` to an actor (``sign`` 1), or back (-1)."""
    floor.add(floor.pools[lender], place, -sign)
    floor.add(actor.own, place, sign)
    change_claim(floor, place, OTHERS, -sign)
    change_claim(floor, place, actor.name, sign)
    if floor.piles.get(place):
        change_pile(floor, place, "")
        change_pile(floor, place, actor.name if sign > 0 else lender)


def change_pile(floor: Floor, place: StationName, who: str) -> None:
    """Put a piece of ``who`` on top of a stack, or take the topmost piece off if ``who`` is empty. Other
    places have no pile and do not change."""
    pile = floor.piles.get(place)
    if pile is not None:
        floor.put(floor.piles, place, (*pile, who) if who else pile[:-1])


def _has_own(floor: Floor, actor: Actor, source: StationName) -> bool:
    """Whether an actor has labware of its own at a place; on a stack, whether it is the topmost piece."""
    pile = floor.piles.get(source)
    return pile[-1] == actor.name if pile else bool(actor.own.get(source))


def _hold(floor: Floor, actor: Actor, motion: Motion) -> None:
    """Carry out a motion that moves nothing. The actor holds what it grabs, borrows what it needs, releases
    what it frees, and returns what was lent."""
    who, lent = actor.name, floor.lent.get(actor.name, ())
    is_early = motion.for_step is not None and not _becomes_ready(actor, motion)
    for key, value in motion.grabs if not is_early else ():
        floor.put(floor.held.setdefault(key, {}), who, value)
    if motion.joint:
        _join(floor, who, motion)
    for key in motion.frees:
        if who in floor.held.get(key, {}):
            floor.drop(floor.held[key], who)
    for key, value in motion.sets:
        floor.put(floor.values, key, value)
    for places in motion.needs:
        _borrow(floor, actor, find_usable_place(floor, actor, places), keeps=motion.keeps)
    if motion.returns and lent:
        for place, owner in lent:
            pile = floor.piles.get(place)
            if pile and (pile[-1] != who or pile.count(who) > 1):
                continue  # which one of several on a stack was lent is not known here
            _change_owner(floor, actor, place, owner, -1)
        floor.put(floor.lent, who, ())
    if motion.heir:
        _leave_all(floor, actor, motion.heir)


def _join(floor: Floor, who: str, motion: Motion) -> None:
    """A module does an action for an actor, and so for all actors with labware in it."""
    ready = floor.held.setdefault(ready_key(motion.joint), {})
    had = floor.held.setdefault(done_key(motion.joint), {})
    if who in had:
        floor.drop(had, who)
        return
    for other in _list_inside(floor, motion.joint):
        if other != who:
            floor.drop(ready, other)
            floor.put(had, other, motion.wish)


def _leave_all(floor: Floor, actor: Actor, heir: Owner) -> None:
    """Give all labware of an actor to the ``heir``."""
    pool = floor.pools.setdefault(heir, {})
    for place, number in actor.own.items():
        if not number:
            continue
        floor.add(pool, place, number)
        floor.add(actor.own, place, -number)
        change_claim(floor, place, OTHERS, number)
        change_claim(floor, place, actor.name, -number)
        pile = floor.piles.get(place, ())
        if actor.name in pile:
            left = tuple(heir if owner == actor.name else owner for owner in pile)
            floor.put(floor.piles, place, left)


def _borrow(floor: Floor, actor: Actor, place: StationName, *, keeps: bool) -> None:
    """Lend the labware at a place to an actor until its end, or for good if it ``keeps`` it."""
    lender = _take_over(floor, actor, place)
    if keeps:
        _keep_loan(floor, actor, place)
    elif lender is not None:
        floor.put(floor.lent, actor.name, (*floor.lent.get(actor.name, ()), (place, lender)))


def _keep_loan(floor: Floor, actor: Actor, place: StationName) -> None:
    """Let an actor keep what was lent to it at a place."""
    lent = floor.lent.get(actor.name)
    if lent:
        floor.put(floor.lent, actor.name, tuple(loan for loan in lent if loan[0] != place))
