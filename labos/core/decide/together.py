"""Actions of several runs that one device carries out at once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from labos.core.actions import ActionRequested
from labos.core.canonical import encode_canonical
from labos.core.decide._base import Decision, InnerCommand, Rejection, decides
from labos.core.decide.actions import StartStep, request_action
from labos.core.decide.inputs import fill_inputs, name_returned_files
from labos.core.effects import find_labware_used
from labos.core.ids import LabwareId
from labos.core.model import Plan, PlanStep
from labos.core.registry import Event
from labos.core.runs import RunState, find_results
from labos.core.state import LabState
from labos.core.together import find_together


class StartTogether(InnerCommand, frozen=True):
    """Request the actions of one step of each of several runs. Their device carries them out at once. All of
    them start, or none."""

    starts: tuple[StartStep, ...]


@decides(StartTogether)
def start_together(state: LabState, command: StartTogether) -> Decision:
    names = {start.run for start in command.starts}
    if len(names) < 2 or len(names) < len(command.starts):
        return Rejection("not_together", "Only steps of different runs are started together.")
    if fault := _find_difference(state, command):
        return Rejection("not_together", fault)
    together = tuple(start.action for start in command.starts)
    events: list[Event] = []
    for start in command.starts:
        decided = request_action(state, start, names - {start.run}, together)
        if isinstance(decided, Rejection):
            return decided
        events += decided
    requests = [event for event in events if isinstance(event, ActionRequested)]
    used = [labware for request in requests for labware in find_labware_used(request.effects)]
    if len(requests) < len(names) or len(set[LabwareId](used)) < len(used):
        return Rejection("not_together", f"Each of {', '.join(sorted(names))} needs its own labware there.")
    return events


def _find_difference(state: LabState, command: StartTogether) -> str:
    """Why steps cannot be carried out at once; empty if they can."""
    wishes: set[bytes | None] = set()
    for start in command.starts:
        run = state.runs.active.get(start.run)
        if run is None or not 0 <= start.step < len(run.steps):
            return f"{start.run} has not started, or has no such step."
        step = state.runs.plan_of(run).steps[start.step]
        if find_together(state, step) is None:
            return f"{step.module} does {step.action!r} for only one run at a time."
        wishes.add(find_wish(state, run, start.step))
    is_one = len(wishes) == 1 and None not in wishes
    return "" if is_one else "Steps with different arguments cannot be done together."


def find_wish(state: LabState, run: RunState, index: int) -> bytes | None:
    """The request of a run's step to its device, with the results of earlier steps. Steps with the same
    request can be carried out together. None if it cannot be computed."""
    plan = state.runs.plan_of(run)
    step = plan.steps[index]
    args = fill_inputs(plan, find_results(plan, run), step.args)
    given = args if isinstance(args, str) else name_returned_files(plan, step, args)
    return None if isinstance(given, str) else encode_canonical([step.module, step.action, *given])


def find_planned_wish(plan: Plan, step: PlanStep) -> bytes | None:
    """The same request from the plan alone; None if it depends on results of earlier steps."""
    if any(isinstance(value, Mapping) and "$result" in value for value in step.args.values()):
        return None
    return encode_canonical([step.module, step.action, step.args, _list_files(plan, step.args)])


def _list_files(plan: Plan, args: Mapping[str, Any]) -> dict[str, str]:
    named = [value for value in args.values() if isinstance(value, str)]
    return {name: digest for name, digest in plan.files.items() if name in named}
