"""A way to the end for everybody inside, taken from a suggested order.

Where many runs share few places, a search for such a way may end before it has found one. A suggested order
is one more way to try. It is tried like any other: every motion has to be possible.
"""

from __future__ import annotations

from collections.abc import Sequence

from labos.core.state import LabState
from labos.planning.floor import Actor, Floor
from labos.planning.orders import list_next_steps
from labos.planning.witness import Trail, Witness, copy, copy_actor, finish_one_by_one, list_order, take_step


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
    ground = copy(floor)
    trail: Trail = []
    left = {name: {motion.step for motion in actor.motions[actor.done :]} for name, actor in here.items()}
    for one in order.steps:
        actor = here.get(one.run)
        if actor is None or one.step not in left[one.run]:
            continue  # it waits outside, or the step is over, or moves nothing
        if one.step not in list_next_steps(actor) or not take_step(ground, actor, one.step, trail):
            return None
    waiting = finish_one_by_one(
        ground, [actor for actor in here.values() if actor.done < actor.length], trail
    )
    return None if any(actor.name in wanted for actor in waiting) else tuple(list_order(trail))
