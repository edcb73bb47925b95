"""Plans: workflows with their payload filled in, each kept once for all runs that need it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import msgspec

from labos.core.ids import CampaignId, ModuleName
from labos.core.model import MAIN, Hold, Plan, PlanStep
from labos.core.registry import Event, event
from labos.core.resources import list_used_up


@event("plan.recorded")
class PlanRecorded(Event, frozen=True):
    """A plan is recorded: a workflow with its payload filled in, identified by its digest. ``shape`` is the
    digest of its effects on the bench; plans with the same shape start under the same conditions. ``by`` is
    the run or experiment that needed the plan first. ``campaign``: the plan belongs only to runs of a
    campaign that not everybody may see."""

    by: str
    plan: str
    shape: str
    workflow: str
    workcell: str
    steps: int
    feeds: tuple[int, ...]
    files: dict[str, str]
    holds: tuple[Hold, ...] = ()
    campaign: CampaignId = CampaignId("")

    def stream(self) -> str:
        return self.by


@event("plan.steps_recorded", schema=4)
class PlanStepsRecorded(Event, frozen=True):
    """Steps of a plan, from index ``first``. A long plan needs several of these events."""

    by: str
    plan: str
    first: int
    steps: tuple[PlanStep, ...]
    campaign: CampaignId = CampaignId("")

    def stream(self) -> str:
        return self.by


class PlanState(msgspec.Struct):
    """``by`` is in whose stream it was recorded; ``uses`` counts runs and experiments that need it;
    ``starts`` are the steps that wait for no other, ``windowed`` those with a window, ``uses_up`` is
    what its steps use up (step, module, resource, amount), ``dangers`` those that take a second person,
    ``conditional`` those that are left out if their condition does not hold."""

    plan: Plan
    shape: str
    expected: int
    by: str = ""
    uses: int = 0
    starts: tuple[int, ...] = ()
    windowed: tuple[int, ...] = ()
    uses_up: tuple[tuple[int, ModuleName, str, float], ...] = ()
    dangers: tuple[int, ...] = ()
    conditional: tuple[int, ...] = ()

    @property
    def complete(self) -> bool:
        return len(self.plan.steps) == self.expected


Plans = dict[str, PlanState]

T = TypeVar("T")

PARTS_KEPT = 4096
_parts: dict[bytes, object] = {}
"""Parts of plans by how they are written, the newest last."""

# What was read of a log or a picture has its keys in order: it need not be brought into one again.
_written = msgspec.json.Encoder().encode


def _share_equal(part: T, make: Callable[[T], T] = lambda part: part) -> T:
    """The part of another plan that is written the same, if one is known: ten thousand waiting plans
    differ in little, and nobody changes a plan. One that is new is kept as ``make`` makes it."""
    key = _written(part)
    known = _parts.get(key)
    if known is None:
        known = _parts[key] = make(part)
        if len(_parts) > PARTS_KEPT:
            del _parts[next(iter(_parts))]
    return known  # type: ignore[return-value]  # what is written the same is of one type


def share_plans(plans: Plans) -> None:
    """What plans have in common is held once."""
    for known in plans.values():
        known.plan = msgspec.structs.replace(known.plan, steps=_share_effects(known.plan.steps))


def _share_effects(steps: tuple[PlanStep, ...]) -> tuple[PlanStep, ...]:
    """The same steps, in as little memory as those of other plans leave them to take."""
    return tuple(_share_equal(step, _share_effects_of_step) for step in steps)


def _share_effects_of_step(step: PlanStep) -> PlanStep:
    return msgspec.structs.replace(step, effects=_share_equal(step.effects))


def plan_recorded(plans: Plans, event: PlanRecorded) -> None:
    plan = Plan(event.workflow, event.workcell, (), event.feeds, event.files, event.holds)
    plans[event.plan] = PlanState(plan, event.shape, event.steps, event.by)


def plan_steps_recorded(plans: Plans, event: PlanStepsRecorded) -> None:
    state = plans[event.plan]
    state.plan = msgspec.structs.replace(state.plan, steps=(*state.plan.steps, *_share_effects(event.steps)))
    if state.complete:
        state.starts = tuple(
            i for i, step in enumerate(state.plan.steps) if not step.after and step.part == MAIN
        )
        state.windowed = tuple(i for i, step in enumerate(state.plan.steps) if step.windows)
        state.uses_up = list_used_up(state.plan.steps)
        state.dangers = tuple(i for i, step in enumerate(state.plan.steps) if step.dangerous)
        state.conditional = tuple(i for i, step in enumerate(state.plan.steps) if step.when is not None)


def release_plan(plans: Plans, digest: str) -> None:
    """One user of a plan less; nobody's plan is forgotten (its events stay in the log)."""
    plan = plans[digest]
    plan.uses -= 1
    if plan.uses <= 0:
        del plans[digest]
