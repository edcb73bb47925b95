"""Recording the suggestions of a planner."""

from __future__ import annotations

from labos.core.decide._base import Command, Decision, Rejection, decides
from labos.core.state import LabState
from labos.core.suggestions import MOST_STEPS, OrderSuggested, Suggested


class SuggestOrder(Command, frozen=True):
    """A planner (``by``) suggests the order in which steps of a workcell should start. It was computed from
    the log up to ``position`` and is valid until ``until`` (UTC ns)."""

    workcell: str
    by: str
    until: int
    steps: tuple[Suggested, ...]
    position: int = 0


@decides(SuggestOrder)
def suggest_order(state: LabState, command: SuggestOrder) -> Decision:
    if command.workcell not in state.lab.workcells:
        names = ", ".join(sorted(state.lab.workcells)) or "none"
        return Rejection(
            "not_found", f"There is no workcell {command.workcell!r}.", f"Name one of these: {names}."
        )
    if len(command.steps) > MOST_STEPS:
        return Rejection(
            "too_many",
            f"A suggestion has at most {MOST_STEPS} steps, and this one has {len(command.steps)}.",
            "Leave out those that start last.",
        )
    if command.position > state.position:
        return Rejection(
            "ahead",
            f"The suggestion was made for position {command.position}, but the log ends at {state.position}.",
            "Make the suggestion from the log of this lab.",
        )
    kept: list[Suggested] = []
    for one in sorted(command.steps, key=lambda step: step.start):
        run = state.runs.get(one.run)
        if run is None:
            continue  # it has ended meanwhile
        plan = state.runs.plan_of(run)
        if plan.workcell != command.workcell:
            return Rejection(
                "elsewhere",
                f"The run {one.run} is in the workcell {plan.workcell}, not in {command.workcell}.",
                "Make one suggestion for each workcell.",
            )
        if not 0 <= one.step < len(plan.steps):
            return Rejection(
                "no_step",
                f"The run {one.run} has no step {one.step}: it has {len(plan.steps)}.",
                "Steps are counted from 0.",
            )
        kept.append(one)
    return [OrderSuggested(command.workcell, command.by, command.until, tuple(kept))]
