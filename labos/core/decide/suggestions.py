"""Recording the suggestions of a planner."""

from __future__ import annotations

from labos.core.decide._base import Command, Decision, Rejection, decides
from labos.core.ids import RunId
from labos.core.state import LabState
from labos.core.suggestions import MOST_STEPS, OrderSuggested, Suggested


class SuggestOrder(Command, frozen=True):
    """A planner (``by``) suggests the order in which steps of a workcell should start. It was computed from
    the log up to ``position`` and is valid until ``until`` (UTC ns). For runs with windows, it may be a
    ``line`` of runs in place of ``steps``: the lab's own search for an order begins with it."""

    workcell: str
    by: str
    until: int
    steps: tuple[Suggested, ...]
    position: int = 0
    line: tuple[RunId, ...] = ()


@decides(SuggestOrder)
def suggest_order(state: LabState, command: SuggestOrder) -> Decision:
    if command.workcell not in state.lab.workcells:
        names = ", ".join(sorted(state.lab.workcells)) or "none"
        return Rejection(
            "not_found", f"There is no workcell {command.workcell!r}.", f"Name one of these: {names}."
        )
    if max(len(command.steps), len(command.line)) > MOST_STEPS:
        return Rejection(
            "too_many",
            f"A suggestion has at most {MOST_STEPS} steps or runs, and this one has "
            f"{max(len(command.steps), len(command.line))}.",
            "Leave out those that start last.",
        )
    if command.steps and command.line:
        return Rejection(
            "two_orders",
            "The suggestion has both an order of steps and a line of runs.",
            "Suggest one of them.",
        )
    if command.position > state.position:
        return Rejection(
            "ahead",
            f"The suggestion was made for position {command.position}, but the log ends at {state.position}.",
            "Make the suggestion from the log of this lab.",
        )
    for name in dict.fromkeys((*(one.run for one in command.steps), *command.line)):
        run = state.runs.get(name)
        if run is not None and (there := state.runs.plan_of(run).workcell) != command.workcell:
            return Rejection(
                "elsewhere",
                f"The run {name} is in the workcell {there}, not in {command.workcell}.",
                "Make one suggestion for each workcell.",
            )
    kept: list[Suggested] = []
    for one in sorted(command.steps, key=lambda step: step.start):
        run = state.runs.get(one.run)
        if run is None:
            continue  # it has ended meanwhile
        steps = state.runs.plan_of(run).steps
        if not 0 <= one.step < len(steps):
            return Rejection(
                "no_step",
                f"The run {one.run} has no step {one.step}: it has {len(steps)}.",
                "Steps are counted from 0.",
            )
        kept.append(one)
    line = tuple(name for name in dict.fromkeys(command.line) if state.runs.get(name) is not None)
    return [OrderSuggested(command.workcell, command.by, command.until, tuple(kept), line)]
