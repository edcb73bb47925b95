"""Which of several modules carries out a step: a run has a plan for each choice, and is bound to one of
them."""

from __future__ import annotations

import msgspec

from labos.core.decide._base import Decision, InnerCommand, Rejection, decides
from labos.core.ids import RunId
from labos.core.model import Plan
from labos.core.runs import PENDING, SKIPPED, RunBound, RunState, RunStatus, find_chosen_modules
from labos.core.state import LabState

MOST_PLANS = 16
"""The most plans from which a run may choose."""


class BindAnew(InnerCommand, frozen=True):
    """An admitted run continues with another of its plans, because a module of its present plan is down.
    ``why`` is for people."""

    run: RunId
    plan: str
    why: str


@decides(BindAnew)
def bind_other_plan(state: LabState, command: BindAnew) -> Decision:
    run = state.runs.active.get(command.run)
    if run is None or command.plan == run.plan or not can_change_to(state, run, command.plan):
        return Rejection("bound", f"{command.run} cannot continue with another of its plans.")
    return [bind(state, msgspec.structs.replace(run, plan=command.plan), command.why)]


def bind(state: LabState, run: RunState, why: str = "") -> RunBound:
    """The event that binds a run to the plan ``run.plan``."""
    chosen = find_chosen_modules(state.runs, run)
    return RunBound(run.id, run.plan, chosen, state.runs.find_plan_stream(run.plan), why)


def can_change_to(state: LabState, run: RunState, plan: str) -> bool:
    """Whether a started run could continue with a plan: the plan is one of the run's own, and the steps that
    have begun are the same in it."""
    if plan not in run.choices or run.status != RunStatus.ACTIVE:
        return False
    old, new = state.runs.plan_of(run), state.runs.plans[plan].plan
    return all(
        step.status in (PENDING, SKIPPED) or old.steps[index] == new.steps[index]
        for index, step in enumerate(run.steps)
    )


def compare_plans(first: Plan, others: tuple[Plan, ...]) -> Rejection | None:
    """Why plans are not the same steps on other modules; None if they are."""
    if len(others) >= MOST_PLANS:
        return Rejection(
            "too_many_choices",
            f"{first.workflow!r} has {len(others) + 1} plans to choose from; {MOST_PLANS} are allowed.",
            "Name fewer modules, or let a step say `same as`.",
        )
    keys = [(step.key, step.part) for step in first.steps]
    for other in others:
        if other.workcell != first.workcell or [(step.key, step.part) for step in other.steps] != keys:
            return Rejection(
                "unlike",
                f"The plans of {first.workflow!r} for its choices differ in more than their modules.",
                "Name the `module:` of transfers between modules that are chosen.",
            )
    return None
