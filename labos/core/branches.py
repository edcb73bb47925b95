"""The ways that a run of a plan may take: which steps fail and are skipped or recovered from, and which are
left out.

Everything that must hold for a plan (its dry run, its safety) must hold for each of these ways, because
nobody knows in advance which way a run will take.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import msgspec

from labos.core.conditions import find_decision, find_reads, holds, sort_results_by_key
from labos.core.effects import Claims, Move, Releases, Sets, Take
from labos.core.expressions import ExpressionError
from labos.core.model import MAIN, Plan
from labos.core.runs import SETTLED, StepStatus, list_rescue_steps

MOST_WAYS = 32
"""The largest number of ways of one plan. Every start of a step in its workcell tries all of them."""


class TooManyWays(Exception):
    """A plan has more ways than can be checked."""


class Way(msgspec.Struct, frozen=True):
    """Steps in an order in which a run may carry them out. ``without`` are steps that failed and are skipped.
    ``rescued`` are failed steps that are replaced by their recovery steps. ``fails``: the run does not
    continue after these steps. ``decisions`` are the decided conditions with their values."""

    steps: tuple[int, ...] = ()
    without: frozenset[int] = frozenset()
    rescued: frozenset[int] = frozenset()
    fails: bool = False
    decisions: tuple[tuple[str, bool], ...] = ()

    @property
    def plain(self) -> bool:
        """Whether no step fails in this way."""
        return not self.without and not self.rescued


def list_ways(plan: Plan, most: int = MOST_WAYS) -> list[Way]:
    """All ways of a plan that differ for the bench; the way without a failure is the first. Raises
    TooManyWays."""
    found = [Way()]
    for index in sort_steps(plan, main_steps(plan)):
        found = [
            longer for way in found for longer in ([way] if way.fails else _extend_way(plan, way, index))
        ]
        if len(found) > most:
            raise TooManyWays(plan.workflow)
    return sorted(dict.fromkeys(found), key=lambda way: not way.plain)


def _extend_way(plan: Plan, way: Way, index: int) -> list[Way]:
    step = plan.steps[index]
    if step.when is None:
        return _find_own_ways(plan, way, index)
    what, positive = find_decision(step.when)
    found: list[Way] = []
    known = dict(way.decisions)
    for value in [known[what]] if what in known else [positive, not positive]:
        extended = msgspec.structs.replace(way, decisions=tuple({**known, what: value}.items()))
        found += _find_own_ways(plan, extended, index) if value == positive else [extended]
    return found


def _find_own_ways(plan: Plan, way: Way, index: int) -> list[Way]:
    """The ways that a step itself may take: it succeeds, is skipped, or is recovered from."""
    found = [msgspec.structs.replace(way, steps=(*way.steps, index))]
    policy = plan.steps[index].on_error
    if policy is None:
        return found
    if policy.do in ("skip", "ask") and policy.may_skip and not is_inert(plan, index):
        found.append(msgspec.structs.replace(way, without=way.without | {index}))
    if policy.do == "run":
        steps = sort_steps(plan, list_rescue_steps(plan, index))
        fails = policy.then == "fail"
        still = all(is_inert(plan, step) for step in steps)
        if not still or not (fails or is_inert(plan, index)):
            found.append(
                msgspec.structs.replace(
                    way, steps=(*way.steps, *steps), rescued=way.rescued | {index}, fails=fails
                )
            )
    return found


def may_leave_out(plan: Plan, index: int) -> bool:
    """Whether a step's failure needs no way of its own: the run continues, and neither the step nor its
    replacement changes labware or doors."""
    policy = plan.steps[index].on_error
    if policy is None or not is_inert(plan, index):
        return False
    if policy.do == "run":
        return policy.then == "go_on" and all(is_inert(plan, step) for step in list_rescue_steps(plan, index))
    return policy.do == "skip" or policy.may_skip


def find_decided(plan: Plan, steps: Sequence[StepStatus], results: Mapping[int, Any]) -> dict[str, bool]:
    """The known values of a run's conditions, from the states of its steps and their results."""
    conditional = [step.when for step in plan.steps if step.when is not None]
    if not conditional:
        return {}
    open_ = {step.key for step, status in zip(plan.steps, steps, strict=True) if status not in SETTLED}
    known: dict[str, bool] = {}
    for condition in conditional:
        what, positive = find_decision(condition)
        if what in known or not open_.isdisjoint(find_reads(condition)):
            continue
        try:
            known[what] = holds(condition, sort_results_by_key(plan, results)) == positive
        except ExpressionError:
            continue  # its run is about to fail
    return known


def main_steps(plan: Plan) -> list[int]:
    """The steps of the workflow itself, without those for emergencies."""
    return [index for index, step in enumerate(plan.steps) if step.part == MAIN]


def is_inert(plan: Plan, index: int) -> bool:
    """Whether leaving a step out makes no difference to labware and doors."""
    changes = (Move, Take, Sets, Claims, Releases)
    held = any(index in (hold.first, hold.last) for hold in plan.holds)
    return not held and not any(isinstance(effect, changes) for effect in plan.steps[index].effects)


def sort_by_predecessors(before: Mapping[int, Iterable[int]]) -> list[int]:
    """Steps in an order in which each stands behind those ``before`` it; what may be first is in the order of
    the plan. Those that wait for one another, or for a step that is not there, and all behind them, are left
    out."""
    followers: dict[int, list[int]] = {}
    waiting = dict.fromkeys(before, 0)
    for index, steps in before.items():
        for step in steps:
            followers.setdefault(step, []).append(index)
            waiting[index] += 1
    ready = [index for index, count in waiting.items() if not count]
    heapq.heapify(ready)
    order: list[int] = []
    while ready:
        order.append(heapq.heappop(ready))
        for follower in followers.get(order[-1], ()):
            waiting[follower] -= 1
            if not waiting[follower]:
                heapq.heappush(ready, follower)
    return order


def list_all_before(before: Callable[[int], Iterable[int]], index: int) -> set[int]:
    """All steps that stand before one, directly or not; ``before`` says which do so directly."""
    found: set[int] = set()
    open_ = [*before(index)]
    while open_:
        step = open_.pop()
        if step not in found:
            found.add(step)
            open_ += before(step)
    return found


def sort_steps(plan: Plan, steps: Iterable[int]) -> Sequence[int]:
    """Some of a plan's steps in an order in which they may run one after the other. Raises ValueError
    if they wait for each other."""
    inside = set(steps)
    order = sort_by_predecessors({index: inside.intersection(plan.steps[index].after) for index in inside})
    if len(order) < len(inside):
        raise ValueError(f"the steps of {plan.workflow!r} wait for each other")
    return order
