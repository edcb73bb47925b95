"""Runs whose steps have several possible orders.

An actor's motions are in one order: the written order of its steps, or the last order that was possible. If
this order is blocked, another one may be possible. Example: one of two branches of a run has taken the only
place. That branch has to go on first, even if the other one is written first. So a step may be brought
forward if the ``after`` relations of its plan allow it. The motions are computed again for each order.
"""

from __future__ import annotations

from collections.abc import Sequence

from labos.planning.floor import Actor, is_closing
from labos.planning.paths import END, Motion, MotionStep, Orders


def list_next_steps(actor: Actor) -> list[MotionStep]:
    """The steps with motions that an actor may do next; the step of its next motion is the first."""
    first = actor.find_next_step()
    if actor.orders is None or first is None:
        return [] if first is None else [first]
    left = list(dict.fromkeys(motion.step for motion in actor.motions[actor.done :]))
    open_ = set(left)
    behind = actor.orders.behind
    return [step for step in left if isinstance(step, int) and open_.isdisjoint(behind[step])] or left[:1]


def bring_forward(actor: Actor, step: MotionStep) -> bool:
    """Put a step before all other steps that an actor has left; return whether that is possible. The step is
    one of ``list_next_steps``."""
    first = actor.find_next_step()
    if first is None or first == step:
        return first is not None
    here = actor.motions[actor.done :]
    done = list(dict.fromkeys(motion.step for motion in actor.motions[: actor.done]))
    rest = [other for other in dict.fromkeys(motion.step for motion in here) if other != step]
    motions = _arrange(actor, [*done, step, *rest])
    if motions is None or motions[: actor.done] != actor.motions[: actor.done]:
        return False
    actor.motions = motions
    return True


def put_in_order(actor: Actor, order: Sequence[MotionStep]) -> None:
    """Give an actor an order of steps that was found before. Nothing changes if these are not exactly the
    steps of its motions, or if the order is not possible."""
    mine = list(dict.fromkeys(motion.step for motion in actor.motions))
    if actor.orders is None or order == mine or set(order) != set(mine):
        return
    motions = _arrange(actor, order)
    if motions is not None:
        actor.motions = motions


def _arrange(actor: Actor, order: Sequence[MotionStep]) -> tuple[Motion, ...] | None:
    """The motions of an actor in this order of its steps. None if its plan does not allow the order, or if
    other steps than these would have motions in it."""
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
    """All steps that are left: those with motions in this order, each of the others as early as possible."""
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
