"""Runs whose steps may be done in more orders than one.

An actor's motions stand in one order: as its steps are written, or as they were found to be possible last.
Where that order is blocked, another one may not be: of two branches of a run the one that has taken the only
place has to go on first, whichever is written first. So a step may be brought forward, if the ``after``
relations of its plan allow that. The motions are worked out anew for each order.
"""

from __future__ import annotations

from collections.abc import Sequence

from labos.planning.floor import Actor, is_closing
from labos.planning.paths import END, Motion, MotionStep, Orders


def list_next_steps(actor: Actor) -> list[MotionStep]:
    """The steps that an actor may do next, those of its motions only; that of its next motion first."""
    left = list(dict.fromkeys(motion.step for motion in actor.motions[actor.done :]))
    if actor.orders is None or not left:
        return left[:1]
    open_ = set(left)
    behind = actor.orders.behind
    return [step for step in left if isinstance(step, int) and open_.isdisjoint(behind[step])] or left[:1]


def bring_forward(actor: Actor, step: MotionStep) -> bool:
    """Put a step before all others that an actor has left; whether that is possible. The step must be one of
    those that it may do next."""
    here = actor.motions[actor.done :]
    if not here or here[0].step == step:
        return bool(here)
    done = list(dict.fromkeys(motion.step for motion in actor.motions[: actor.done]))
    rest = [other for other in dict.fromkeys(motion.step for motion in here) if other != step]
    motions = _arrange(actor, [*done, step, *rest])
    if motions is None or motions[: actor.done] != actor.motions[: actor.done]:
        return False
    actor.motions = motions
    return True


def put_in_order(actor: Actor, order: Sequence[MotionStep]) -> None:
    """Give an actor an order of its steps that was found before, if it still is one of all that are left."""
    mine = list(dict.fromkeys(motion.step for motion in actor.motions))
    if actor.orders is None or order == mine or set(order) != set(mine):
        return
    motions = _arrange(actor, order)
    if motions is not None:
        actor.motions = motions


def _arrange(actor: Actor, order: Sequence[MotionStep]) -> tuple[Motion, ...] | None:
    """The motions that an actor has left in this order of its steps; None if its plan does not allow it, or
    if other steps move something then."""
    orders = actor.orders
    assert orders is not None
    steps = [step for step in order if isinstance(step, int)]
    seen: set[int] = set()
    for step in steps:
        if not seen.issuperset(orders.behind[step] & set(steps)):
            return None
        seen.add(step)
    left = [step for step in orders.steps if step not in actor.over]
    whole = [step for step in orders.steps if step in actor.over] + _fill_in(orders, left, steps)
    open_ = set(left)
    found = tuple(m for m in orders.list_motions(tuple(whole)) if m.step in open_ or m.step == END)
    if {motion.step for motion in found if motion.step != END} != seen:
        return None
    return (*found, *(motion for motion in actor.motions if is_closing(motion) or motion.heir))


def _fill_in(orders: Orders, left: Sequence[int], steps: Sequence[int]) -> list[int]:
    """All steps that are left, those that move something in this order, the others as soon as they may."""
    order: list[int] = []
    moving, still = set(steps), [step for step in left if step not in steps]
    for step in [*steps, None]:
        open_ = moving - set(order)
        ready = [other for other in still if open_.isdisjoint(orders.behind[other])]
        order += ready
        still = [other for other in still if other not in ready]
        if step is not None:
            order.append(step)
    return order
