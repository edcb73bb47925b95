"""How a run ends, and what follows for it when one of its steps has."""

from __future__ import annotations

from typing import Any

import msgspec

from labos.core.conditions import by_key, holds
from labos.core.decide.windows import withdrawn
from labos.core.effects import Claims
from labos.core.experiments import ExperimentEnded
from labos.core.expressions import ExpressionError
from labos.core.ids import (
    InterventionId,
    LabwareId,
    Owner,
    StationName,
    experiment_owner,
    local,
    run_owner,
    user_owner,
)
from labos.core.interventions import UNNUMBERED, Choice, InterventionRequested
from labos.core.labware import LabwareHandedOver
from labos.core.leaving import will_leave
from labos.core.model import Plan
from labos.core.modules import SetpointReleased
from labos.core.registry import Event
from labos.core.runs import (
    DONE,
    FAILED,
    IN_FLIGHT,
    PENDING,
    SETTLED,
    SKIPPED,
    UNKNOWN,
    RunCancelled,
    RunCancelling,
    RunCompleted,
    RunFailed,
    RunState,
    rescuers,
)
from labos.core.state import LabState
from labos.core.steps import StepSkipped


class Placement(msgspec.Struct, frozen=True):
    """Where a batch of events leaves labware: at a station, nobody knows where (empty), or off
    the bench (``gone``)."""

    labware: LabwareId
    station: str = ""
    gone: bool = False


def under_way(run: RunState) -> bool:
    """Whether an action of the run has not ended: until then the run cannot end either."""
    return any(step in (IN_FLIGHT, UNKNOWN) for step in run.steps)


def giving_up(
    state: LabState,
    run: RunState,
    why: str,
    *,
    answered: InterventionId = UNNUMBERED,
    kind: str = "experiment",
) -> list[Event]:
    """A run ends as failed, as soon as nothing of it is in flight. ``answered`` is the question to
    which this is the answer, ``kind`` the class of failure."""
    if under_way(run):
        return [RunCancelling(run.id, why)]
    end = RunFailed(run.id, why, kind)
    return ending(state, run, end, f"failed: {why}", answered=answered)


def ending(
    state: LabState,
    run: RunState,
    end: RunCompleted | RunFailed | RunCancelled,
    what: str,
    *,
    extra: tuple[Placement, ...] = (),
    answered: InterventionId = UNNUMBERED,
) -> list[Event]:
    """The events that end a run: its labware goes to its experiment or user; what it leaves in
    the way is shown to a person. ``extra`` says where the same batch leaves labware, ``answered``
    which question about it the same batch answers."""
    heir = user_owner(run.user)
    experiment = state.campaigns.experiments.get(run.experiment)
    if experiment is not None and not run.closing:
        heir = experiment_owner(run.experiment)
    events: list[Event] = withdrawn(state, run.id, "the run has ended", answered=answered)
    stations: dict[LabwareId, str] = {item.id: item.station for item in state.bench.owned(run_owner(run.id))}
    gone = {placement.labware for placement in extra if placement.gone}
    gone |= {state.bench.labware[name].lid for name in gone & state.bench.labware.keys()}
    stations.update({placement.labware: placement.station for placement in extra})
    left: list[LabwareId] = []
    stands: list[str] = []
    for labware, place in stations.items():
        if labware in gone:
            continue
        events.append(LabwareHandedOver(labware, run.id, Owner(heir)))
        if place and not state.bench.stations[StationName(place)].spec.is_storage:
            left.append(labware)
            stands.append(f"{labware} at {local(place)}")
    events += _let_go(state, run)
    if left and not isinstance(end, RunCompleted):
        events.append(
            InterventionRequested(
                UNNUMBERED,
                "failed_run",
                run.id,
                f"Run {run.id} ({run.workflow}) {what.rstrip('.')}. It left {', '.join(stands)}.",
                (
                    Choice("removed", "The labware was carried away; its stations are free."),
                    Choice("leave", "It stays where it is, as its user's labware."),
                ),
                run=run.id,
                labware=tuple(left),
            )
        )
    events.append(end)
    if experiment is not None and run.closing:
        for item in state.bench.owned(experiment_owner(run.experiment)):  # what it did not clear away
            events.insert(-1, LabwareHandedOver(item.id, run.id, heir))
        events.append(ExperimentEnded(run.experiment, experiment.closing))
    return events


def _let_go(state: LabState, run: RunState) -> list[Event]:
    """What lets go of a run's setpoints; also of those that it claims with the very action that ends it."""
    cell = state.runs.plan_of(run).workcell
    held = {
        (name, setpoint): True
        for name, module in state.modules.within(cell)
        for setpoint, now in module.setpoints.items()
        if run.id in now.holders
    }
    for action in state.actions.within(cell):
        if action.run == run.id:
            held |= {(action.module, e.setpoint): True for e in action.effects if isinstance(e, Claims)}
    return [SetpointReleased(module, setpoint, run.id) for module, setpoint in held]


def conclude(
    state: LabState,
    run: RunState,
    step: int,
    outcome: int,
    why: str,
    extra: tuple[Placement, ...] = (),
    *,
    answered: InterventionId = UNNUMBERED,
    kind: str = "software",
    result: Any = None,
) -> list[Event]:
    """What follows for a run when one of its steps has come to ``outcome`` (DONE, SKIPPED, FAILED or
    PENDING again): its end, if nothing of it is left to wait for. ``kind`` is the class of a failure,
    ``result`` what a step that is done has given."""
    steps = list(run.steps)
    steps[step] = outcome
    if outcome == SKIPPED:
        _rest(state.runs.plan_of(run), steps, step)
    in_flight = IN_FLIGHT in steps or UNKNOWN in steps
    events: list[Event] = []
    if outcome == DONE and run.status != "cancelling":
        rescued = _rescued_by(state.runs.plan_of(run), steps, step)
        if rescued is not None:
            policy = state.runs.plan_of(run).steps[rescued].on_error
            why = run.troubles.get(str(rescued), "")
            if policy is None or policy.then == "fail":
                outcome = FAILED
            else:
                events.append(StepSkipped(run.id, rescued, f"recovered: {why}"))
                steps[rescued] = SKIPPED
                _rest(state.runs.plan_of(run), steps, rescued)

    if outcome in SETTLED and run.status != "cancelling":
        fresh = {str(step): result} if outcome == DONE else {}
        left_out, fault = _left_out(state.runs.plan_of(run), run, steps, fresh)
        events += left_out
        if fault:
            outcome, why, kind = FAILED, fault, "experiment"

    def end(as_: RunCompleted | RunFailed | RunCancelled, what: str) -> list[Event]:
        return [*events, *ending(state, run, as_, what, extra=extra, answered=answered)]

    if set(steps) <= set(SETTLED):
        if run.status == "leaving":
            return end(RunCancelled(run.id), "was cancelled")
        return end(RunCompleted(run.id, steps.count(DONE)), "completed")
    if will_leave(state.runs.plan_of(run), run) and not in_flight:
        return events  # its way out begins where this has left its labware
    if outcome == FAILED:
        if in_flight:
            return [*events, RunCancelling(run.id, why)]
        why = run.why or why
        if run.status == "leaving":
            return end(RunCancelled(run.id), f"was cancelled, and its way out failed: {why.rstrip('.')}")
        return end(RunFailed(run.id, why, kind), f"failed: {why}")
    if run.status == "cancelling" and not in_flight:
        if run.why:
            return end(RunFailed(run.id, run.why, "software"), f"failed: {run.why}")
        return end(RunCancelled(run.id), "was cancelled")
    return events


def _rest(plan: Plan, steps: list[int], step: int) -> None:
    """What was for the case that a step fails is not needed any more."""
    for index, other in enumerate(plan.steps):
        if other.part == step and steps[index] != DONE:
            steps[index] = SKIPPED


def _left_out(plan: Plan, run: RunState, steps: list[int], fresh: dict[str, Any]) -> tuple[list[Event], str]:
    """The steps whose turn has come and whose condition does not hold; and why one could not be decided.
    Changes their states."""
    events: list[Event] = []
    results: dict[str, Any] | None = None
    again = True
    while again:
        again = False
        for index, step in enumerate(plan.steps):
            if step.when is None or steps[index] != PENDING:
                continue
            if any(steps[before] not in SETTLED for before in step.after):
                continue
            if results is None:
                results = by_key(plan, {**run.results, **fresh})
            try:
                wanted = holds(step.when, results)
            except ExpressionError as error:
                return events, f"the condition of step {step.key!r} cannot be decided: {error.message}"
            if not wanted:
                events.append(StepSkipped(run.id, index, f"{step.when.text} does not hold"))
                steps[index] = SKIPPED
                _rest(plan, steps, index)
                again = True
    return events, ""


def _rescued_by(plan: Plan, steps: list[int], step: int) -> int | None:
    """The failed step whose recovery is over with this step."""
    part = plan.steps[step].part
    if part < 0 or steps[part] != FAILED or step not in rescuers(plan, part):
        return None
    return part if all(steps[index] in SETTLED for index in rescuers(plan, part)) else None
