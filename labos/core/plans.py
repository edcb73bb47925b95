"""Plans: workflows with their payload filled in. Each is stored once for all runs that use it."""

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

    STREAM = "by"
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


@event("plan.steps_recorded", schema=4)
class PlanStepsRecorded(Event, frozen=True):
    """Steps of a plan, from index ``first``. A long plan needs several of these events."""

    STREAM = "by"
    by: str
    plan: str
    first: int
    steps: tuple[PlanStep, ...]
    campaign: CampaignId = CampaignId("")


class PlanState(msgspec.Struct):
    """``by`` is the run or experiment whose stream has the plan. ``uses`` counts the runs and experiments
    that need it. ``starts`` are the steps that wait for no other step, and ``windowed`` those with a window.
    ``uses_up`` is the consumption of its steps (step, module, resource, amount). ``dangers`` are the steps
    that need the approval of a second person. ``conditional`` are the steps with a condition."""

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

    def add(self, more: tuple[PlanStep, ...]) -> None:
        """Add the next steps."""
        steps = (*self.plan.steps, *_share_effects(more))
        self.plan = msgspec.structs.replace(self.plan, steps=steps)
        if self.complete:
            self.starts = tuple(i for i, step in enumerate(steps) if not step.after and step.part == MAIN)
            self.windowed = tuple(i for i, step in enumerate(steps) if step.windows)
            self.uses_up = list_used_up(steps)
            self.dangers = tuple(i for i, step in enumerate(steps) if step.dangerous)
            self.conditional = tuple(i for i, step in enumerate(steps) if step.when is not None)


Plans = dict[str, PlanState]

T = TypeVar("T")

PARTS_KEPT = 4096
_parts: dict[bytes, object] = {}
"""Parts of plans by their encoded form, the newest last."""

# Values that were read from a log or a snapshot have sorted keys; they need not be sorted again.
_written = msgspec.json.Encoder().encode


def _share_equal(part: T, make: Callable[[T], T] = lambda part: part) -> T:
    """The equal part of another plan, if one is known. Ten thousand waiting plans differ little, and plans
    are never changed, so they can share parts. A new part is stored as ``make`` returns it."""
    key = _written(part)
    known = _parts.get(key)
    if known is None:
        known = _parts[key] = make(part)
        if len(_parts) > PARTS_KEPT:
            del _parts[next(iter(_parts))]
    return known  # type: ignore[return-value]  # what is written the same is of one type


def share_plans(plans: Plans) -> None:
    """Let plans share their equal parts in memory."""
    for known in plans.values():
        known.plan = msgspec.structs.replace(known.plan, steps=_share_effects(known.plan.steps))


def _share_effects(steps: tuple[PlanStep, ...]) -> tuple[PlanStep, ...]:
    """The same steps; parts that other plans have too are shared in memory."""
    return tuple(_share_equal(step, _share_effects_of_step) for step in steps)


def _share_effects_of_step(step: PlanStep) -> PlanStep:
    return msgspec.structs.replace(step, effects=_share_equal(step.effects))


def release_plan(plans: Plans, digest: str) -> None:
    """Note that one run or experiment less needs a plan. A plan without users is deleted here (its events
    stay in the log)."""
    plan = plans[digest]
    plan.uses -= 1
    if plan.uses <= 0:
        del plans[digest]
