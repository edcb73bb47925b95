"""Whether runs can still come to their ends after some steps have been started, one after the other."""

from __future__ import annotations

from collections.abc import Sequence

from labos.core.ids import RunId
from labos.core.state import LabState
from labos.planning.floor import Actor, Floor, lay_out, may_move, move
from labos.planning.rehearsal import Who
from labos.planning.safety import Safety, View, as_seen
from labos.planning.witness import copy, fresh


def first_trap(
    state: LabState, cell: str, starts: Sequence[Who], safety: Safety
) -> tuple[Who, tuple[str, ...]] | None:
    """The first of these starts after which some runs could not come to their ends that can now, and which
    runs these are. None if there is no such start, or if somebody's way forks: then planning asks about
    each start when its turn comes."""
    view = View(cell, hopeful=True, closing=True)
    actors = safety.actors(state, cell)
    inside = {actor.name for actor in actors}
    for name in dict.fromkeys(name for name, _ in starts):
        queued = state.runs.queued.get(RunId(name))
        if queued is not None and name not in inside:
            actors.append(safety.actor(state, queued, tail=True))
    if any(actor.forks for actor in actors):
        return None
    here = [as_seen(actor, view) for actor in actors]
    moving = {(actor.name, motion.step) for actor in here for motion in actor.motions}
    starts = [start for start in starts if start in moving]
    if not starts:
        return None
    ground = lay_out(state, cell, here, hopeful=True)
    names = {actor.name for actor in here}
    low, high = 0, len(starts)
    lost = names - _ends(ground, here, starts, safety)
    if not lost:
        return None
    lost &= _ends(ground, here, (), safety)
    if not lost:
        return None
    while high - low > 1:
        middle = (low + high) // 2
        if lost <= _ends(ground, here, starts[:middle], safety):
            low = middle
        else:
            high = middle
    return starts[high - 1], tuple(sorted(lost))


def _ends(ground: Floor, actors: Sequence[Actor], starts: Sequence[Who], safety: Safety) -> set[str]:
    """Who comes to its end after these starts; nobody if one of them is not possible."""
    floor, cast = copy(ground), {actor.name: fresh(actor) for actor in actors}
    for name, step in starts:
        mover = cast[name]
        for motion in [motion for motion in mover.motions if motion.step == step]:
            if not may_move(floor, mover, motion):
                return set()
            move(floor, mover, motion)
        mover.motions = tuple(motion for motion in mover.motions if motion.step != step)
    return safety.find(floor, list(cast.values()), set(cast))[1]
