"""A way to the end for everybody inside, taken from a suggested order.

Where many runs share few places, a search for such a way may end before it has found one. A suggested order
is one more way to try. It is tried like any other: every motion has to be possible.
"""

from __future__ import annotations

from collections.abc import Sequence

from labos.core.state import LabState
from labos.planning.floor import Actor, Floor
from labos.planning.orders import list_next_steps
from labos.planning.witness import Trail, Witness, copy_actor, finish_one_by_one, list_order, take_step


def follow_order(
    state: LabState, cell: str, floor: Floor, actors: Sequence[Actor], wanted: set[str]
) -> Witness | None:
    """A witness that brings all that are ``wanted`` to their ends in the order that is suggested for a
    workcell, and those that it does not name after them; None if there is no order, or it brings one of them
    to a stand. Changes neither floor nor actors."""
    order = state.suggestions.orders.get(cell)
    if order is None or not order.steps:
        return None
    here = {actor.name: copy_actor(actor) for actor in actors if not actor.stuck}
    if not wanted <= here.keys():
        return None
    mark = len(floor.changes)
    trail: Trail = []
    left = {name: {motion.step for motion in actor.motions[actor.done :]} for name, actor in here.items()}
    # Who waits outside is not here; some steps are over, or move nothing.
    moving = ((here[one.run], one.step) for one in order.steps if one.step in left.get(one.run, ()))
    waiting: list[Actor] | None = None
    if all(step in list_next_steps(actor) and take_step(floor, actor, step, trail) for actor, step in moving):
        waiting = finish_one_by_one(
            floor, [actor for actor in here.values() if actor.done < actor.length], trail
        )
    floor.take_back(mark)
    if waiting is None or any(actor.name in wanted for actor in waiting):
        return None
    return tuple(list_order(trail))
