"""The search for a witness: an order of motions that brings actors to their ends.

A step that begins to hold something and carries labware has several motions, but it is started as one. So
a witness keeps the motions of a step together: no other motion can happen between them.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from labos.planning.floor import Actor, Floor
from labos.planning.forks import FORK, finish
from labos.planning.moves import may_move, move
from labos.planning.orders import bring_forward, list_next_steps
from labos.planning.paths import FORKED, Motion, MotionStep

Witness = tuple[tuple[str, MotionStep], ...]
"""(actor, step) for each motion that is left, in an order in which all of them are possible. The motions of a
step follow one another."""

Trail = list[tuple[Actor, Motion, int]]
"""The motions carried out on a floor, in order. The number is that of the floor's changes before the motion,
so that the motion can be taken back."""


def finish_one_by_one(floor: Floor, actors: Sequence[Actor], trail: Trail) -> list[Actor]:
    """Bring one actor after another to its end while one can reach it; returns the actors that are left.
    Actors that end in the waste go first: afterwards they block no other actor. Leaves the motions on the
    floor and appends them to ``trail``."""
    waiting = sorted(actors, key=lambda actor: not _ends_in_waste(floor, actor))
    progress = True
    while waiting and progress:
        progress = False
        for actor in list(waiting):
            if walk(floor, actor, trail):
                waiting.remove(actor)
                progress = True
    return waiting


def _ends_in_waste(floor: Floor, actor: Actor) -> bool:
    for motion in reversed(actor.motions):
        if motion.target:
            return motion.target in floor.endless
    return False


def go_on(floor: Floor, actor: Actor, trail: Trail) -> bool:
    """Carry out an actor's next motion, or all that follows its fork. Returns whether that is possible; if
    not, nothing changes."""
    mark, motion = len(floor.changes), FORK
    if actor.done < len(actor.motions):
        motion = actor.motions[actor.done]
        if not may_move(floor, actor, motion):
            return False
        move(floor, actor, motion)
    elif not finish(floor, actor):
        return False
    trail.append((actor, motion, mark))
    actor.done += 1
    return True


def walk(floor: Floor, actor: Actor, trail: Trail) -> bool:
    """Carry out all that an actor has left. Returns whether that is possible; if not, takes all back."""
    start, length = len(trail), actor.length
    while actor.done < length:
        if not go_on(floor, actor, trail):
            take_all_back(floor, trail, start)
            return False
    return True


def take_step(floor: Floor, actor: Actor, step: MotionStep, trail: Trail) -> bool:
    """Carry out the motions of a step that an actor may do next. Returns whether that is possible; if not,
    takes all motions back."""
    if not bring_forward(actor, step):
        return False
    start = len(trail)
    while actor.find_next_step() == step:
        if not go_on(floor, actor, trail):
            take_all_back(floor, trail, start)
            return False
    return True


def replay(floor: Floor, actors: Sequence[Actor], witness: Witness) -> Witness | None:
    """The witness, checked again in the same order: an actor may have passed a fork, or a person may have put
    something in the way. An actor that goes alone to its end from a fork still does so. None if a motion is
    not possible, or if an actor would not reach its end. Changes neither floor nor actors."""
    mark = len(floor.changes)
    trail: Trail = []
    by_name = {actor.name: copy_actor(actor) for actor in actors}
    is_possible = all(_follow(floor, by_name.get(name), step, trail) for name, step in witness)
    over = is_possible and all(actor.done >= actor.length for actor in by_name.values())
    floor.take_back(mark)
    return tuple(list_order(trail)) if over else None


def _follow(floor: Floor, actor: Actor | None, step: MotionStep, trail: Trail) -> bool:
    """Carry out the next motion of a witness with an actor. Returns whether that is possible."""
    if actor is None:
        return False
    if step == FORKED:
        return walk(floor, actor, trail)
    return actor.find_next_step() == step and go_on(floor, actor, trail)


def take_all_back(floor: Floor, trail: Trail, start: int = 0) -> None:
    """Undo the motions of a trail from ``start`` on."""
    if len(trail) > start:
        floor.take_back(trail[start][2])
        for actor, _, _ in trail[start:]:
            actor.done -= 1
        del trail[start:]


def interleave(floor: Floor, actors: list[Actor], limit: int) -> list[tuple[str, MotionStep]] | None:
    """An interleaving of steps that brings every actor to its end, and stays on the floor. None if there is
    none, or if none is found after ``limit`` positions. If an actor's steps may be done in several orders,
    each step that may be next is tried. Then all next steps are tried before any step that follows them."""
    seen: set[tuple[object, ...]] = set()
    budget = [limit]
    broad = any(actor.orders is not None for actor in actors)

    def deeper(trail: Trail) -> bool:
        """Whether a way to the end of all was found. It is then in ``trail``."""
        opened: list[tuple[Actor, MotionStep]] = []
        for actor, step in [(each, step) for each in actors for step in list_next_steps(each)]:
            if budget[0] <= 0:
                return False
            here = len(trail)
            if not take_step(floor, actor, step, trail):
                continue
            where = tuple(map(_place, actors))
            if where in seen:
                take_all_back(floor, trail, here)
                continue
            budget[0] -= 1
            seen.add(where)
            there = len(trail)
            if not finish_one_by_one(floor, actors, trail):
                return True
            take_all_back(floor, trail, there)
            if broad:
                opened.append((actor, step))
            elif deeper(trail):
                return True
            take_all_back(floor, trail, here)
        for actor, step in opened:
            here = len(trail)
            if take_step(floor, actor, step, trail) and deeper(trail):
                return True
            take_all_back(floor, trail, here)
        return False

    trail: Trail = []
    return list_order(trail) if deeper(trail) else None


def _place(actor: Actor) -> object:
    """How far an actor has come, independent of the order of its steps."""
    if actor.orders is None:
        return actor.done
    return frozenset(motion.step for motion in actor.motions[: actor.done])


def list_order(trail: Trail) -> list[tuple[str, MotionStep]]:
    return [(actor.name, motion.step) for actor, motion, _ in trail]


def copy_actor(actor: Actor) -> Actor:
    """A copy of an actor on which motions can be tried."""
    return msgspec.structs.replace(actor, own=dict(actor.own))
