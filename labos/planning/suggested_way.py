"""A way to the end for all runs inside, taken from a suggested order.

If many runs share few places, the search for such a way may end before it has found one. A suggested order is
one more way to try. It is tried like any other way: every motion has to be possible.
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
    """A witness that brings all ``wanted`` actors to their ends. It follows the order that is suggested for a
    workcell; what the order does not name comes after it. None if there is no order, or if a wanted actor
    cannot reach its end with it. Changes neither floor nor actors."""
    order = state.suggestions.orders.get(cell)
    if order is None or not order.steps:
        return None
    here = {actor.name: copy_actor(actor) for actor in actors if not actor.stuck}
    if not wanted <= here.keys():
        return None
    mark = len(floor.changes)
    trail: Trail = []
    left = {name: {motion.step for motion in actor.motions[actor.done :]} for name, actor in here.items()}
    # The order may name runs that wait outside, steps that are over, and steps that move nothing.
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
