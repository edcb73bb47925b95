"""The events that follow when a step of a run has ended, and the end of runs."""

from __future__ import annotations

from collections.abc import Iterator

from labos.core.actions import ActionReconciled, ActionRejected, ActionSucceeded
from labos.core.conditions import holds, sort_results_by_key
from labos.core.expressions import ExpressionError
from labos.core.ids import Owner, experiment_owner, local, run_owner, user_owner
from labos.core.labware import LabwareHandedOver
from labos.core.leaving import will_leave
from labos.core.modules import SetpointReleased
from labos.core.registry import Event
from labos.core.runs import (
    DONE,
    FAILED,
    IN_FLIGHT,
    PENDING,
    SETTLED,
    UNKNOWN,
    RunCancelled,
    RunCancelling,
    RunCompleted,
    RunEnd,
    RunFailed,
    RunState,
    RunStatus,
    find_results,
    list_rescue_steps,
)
from labos.core.state import LabState
from labos.core.steps import StepSkipped
from labos.core.topics import LeftLabware, name_some, split_into_batches


def has_open_action(run: RunState) -> bool:
    """Whether an action of the run has not ended. Until then the run cannot end either."""
    return run.has(IN_FLIGHT, UNKNOWN)


# -- reactions -----------------------------------------------------------------------------------


def end_recovery(state: LabState, event: ActionSucceeded | ActionReconciled) -> Iterator[Event]:
    """When the last step of a recovery is done, the failed step is skipped, or its run ends as failed."""
    run = state.runs.active.get(event.run)
    if run is None or run.status == RunStatus.CANCELLING or run.steps[event.step].status != DONE:
        return
    plan = state.runs.plan_of(run)
    failed = plan.steps[event.step].serves
    if failed is None or run.steps[failed].status != FAILED:
        return
    recovery = list_rescue_steps(plan, failed)
    if event.step not in recovery or any(run.steps[index].status not in SETTLED for index in recovery):
        return
    policy, why = plan.steps[failed].on_error, run.steps[failed].trouble or ""
    if policy is None or policy.then == "fail":
        yield from fail_run(state, run, why)
    else:
        yield StepSkipped(run.id, failed, f"recovered: {why}")


def skip_steps(state: LabState, event: ActionSucceeded | ActionReconciled | StepSkipped) -> Iterator[Event]:
    """Steps that are next and whose condition is false are skipped; if a condition cannot be evaluated, the
    run ends as failed."""
    run = state.runs.active.get(event.run)
    if run is None or run.status == RunStatus.CANCELLING or run.steps[event.step].status not in SETTLED:
        return
    plan = state.runs.plan_of(run)
    for index in state.runs.plans[run.plan].conditional:
        step = plan.steps[index]
        if step.when is None or run.steps[index].status != PENDING:
            continue
        if any(run.steps[before].status not in SETTLED for before in step.after):
            continue
        try:
            wanted = holds(step.when, sort_results_by_key(plan, find_results(plan, run)))
        except ExpressionError as error:
            why = f"the condition of step {step.key!r} cannot be evaluated: {error.message}"
            yield from fail_run(state, run, why, "experiment")
            return
        if not wanted:
            yield StepSkipped(run.id, index, f"{step.when.text} does not hold")


def end_run(
    state: LabState, event: ActionSucceeded | ActionReconciled | ActionRejected | StepSkipped
) -> Iterator[Event]:
    """A run ends when all its steps are done or skipped, or when it is being cancelled and none of its
    actions is under way."""
    run = state.runs.active.get(event.run)
    if run is None or run.steps[event.step].status == FAILED:
        return
    # From the last part to the first: the next part to carry out is at the end.
    if all(step.status in SETTLED for step in reversed(run.steps)):
        if run.status == RunStatus.LEAVING:
            yield from record_end(state, run, RunCancelled(run.id), "was cancelled")
        else:
            yield from record_end(state, run, RunCompleted(run.id, run.statuses.count(DONE)), "completed")
    elif (
        run.status == RunStatus.CANCELLING
        and not has_open_action(run)
        and not will_leave(state.runs.plan_of(run), run)
    ):
        if run.why:
            yield from record_end(state, run, RunFailed(run.id, run.why, "software"), f"failed: {run.why}")
        else:
            yield from record_end(state, run, RunCancelled(run.id), "was cancelled")


# -- endings -------------------------------------------------------------------------------------


def fail_run(state: LabState, run: RunState, why: str, kind: str = "software") -> Iterator[Event]:
    """A step has failed, and with it the run. A cancelled run carries out its ``on_cancel`` steps first."""
    if not has_open_action(run) and will_leave(state.runs.plan_of(run), run):
        return  # its ``on_cancel`` steps begin at the places where this action has left its labware
    if not has_open_action(run) and run.status == RunStatus.LEAVING:
        what = f"was cancelled, and its way out failed: {(run.why or why).rstrip('.')}"
        yield from record_end(state, run, RunCancelled(run.id), what)
    else:
        yield from give_up(state, run, why, kind)


def give_up(state: LabState, run: RunState, why: str, kind: str = "experiment") -> Iterator[Event]:
    """End a run as failed, as soon as nothing of it is in flight. ``kind`` is the class of failure."""
    if has_open_action(run):
        yield RunCancelling(run.id, why)
    else:
        why = run.why or why
        yield from record_end(state, run, RunFailed(run.id, why, kind), f"failed: {why}")


def record_end(state: LabState, run: RunState, end: RunEnd, what: str) -> Iterator[Event]:
    """The events that end a run. Its labware goes to its experiment or user, and a person is asked about
    labware that it leaves in the way."""
    heir = user_owner(run.user)
    experiment = state.experiments.open.get(run.experiment)
    if experiment is not None and not run.closing:
        heir = experiment_owner(run.experiment)
    in_the_way = []
    for item, lender in [(item, item.lender) for item in state.bench.list_owned(run_owner(run.id))]:
        yield LabwareHandedOver(item.id, run.id, lender or Owner(heir))
        if not lender and item.station and not state.bench.stations[item.station].spec.is_storage:
            in_the_way.append(item)
    cell = state.runs.plan_of(run).workcell
    for name, module in state.modules.list_in_cell(cell):
        for setpoint, now in list(module.setpoints.items()):
            if run.id in now.holders:
                yield SetpointReleased(name, setpoint, run.id)
    if in_the_way and not isinstance(end, RunCompleted):
        for some in split_into_batches(LeftLabware, in_the_way):
            stands = name_some([f"{item.id} at {local(item.station)}" for item in some])
            left = LeftLabware(run=run.id, labware=tuple(item.id for item in some))
            yield state.interventions.ask(
                left, f"Run {run.id} ({run.workflow}) {what.rstrip('.')}. It left {stands}."
            )
    yield end  # the last event in the run's stream
