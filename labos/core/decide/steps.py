"""The events for a step whose action has failed or does not end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from labos.core.actions import (
    Action,
    ActionFailed,
    ActionReconciled,
    ActionRejected,
    ActionSucceeded,
    ActionUnknown,
    EffectsDone,
)
from labos.core.branches import is_inert
from labos.core.canonical import encode_canonical
from labos.core.conditions import holds, sort_results_by_key
from labos.core.decide._base import Decision, InnerCommand
from labos.core.decide.endings import fail_run, give_up
from labos.core.decide.lookups import decides_about, find_action
from labos.core.decide.outcomes import find_carried_off, make_question, mark_uncertain
from labos.core.decide.waiting import ask_about_waiting_device
from labos.core.effects import Requires, Sets, list_carried, list_moved
from labos.core.expressions import ExpressionError
from labos.core.ids import ActionId, RunId, local
from labos.core.interventions import InterventionRequested
from labos.core.labware import LabwareUncertain
from labos.core.model import Plan, PlanStep
from labos.core.registry import Event
from labos.core.rules import NODE_AWAY_S, find_due_time, find_give_up_time, find_standstill_time
from labos.core.runs import FAILED, RunState, RunStatus, find_results
from labos.core.state import LabState
from labos.core.steps import StepRecovering, StepRetried, StepSkipped, StepUnexpected
from labos.core.structs import make_from
from labos.core.topics import FailedStep


class TimeOutAction(InnerCommand, frozen=True):
    """An action has no result: its time-out has passed, its node stays away, or its device stands still and
    reports why."""

    action: ActionId
    now: int


@decides_about(TimeOutAction, find_action)
def time_out_action(state: LabState, command: TimeOutAction, action: Action) -> Decision:
    due, missed = find_due_time(state, action), find_give_up_time(state, action)
    if due is not None and command.now > due:
        step = state.runs.plan_of(state.runs.active[action.run]).steps[action.step]
        return doubt(state, action, f"it did not end within {step.timeout_s:g} s")
    if missed is not None and command.now > missed:
        return doubt(state, action, f"its node has been gone for {NODE_AWAY_S:g} s")
    stuck = find_standstill_time(state, action)
    return [ask_about_waiting_device(state, action)] if stuck is not None and command.now > stuck else []


def doubt(
    state: LabState, action: Action, why: str, maybe: Sequence[LabwareUncertain] | None = None
) -> list[Event]:
    """The events when it cannot be found out how an action ended. ``maybe`` lists the possible places of its
    labware, if more is known about them."""
    unknown = make_from(ActionUnknown, action, action=action.id, why=why)
    if maybe is None:
        seen = find_carried_off(state, action)
        moves = [move for move in list_moved(action.effects) if move.labware not in seen]
        maybe = [mark_uncertain(action, effect, why) for effect in moves]
    return [unknown, *maybe, make_question(state, action, why, maybe)]


# -- reactions -----------------------------------------------------------------------------------


def check_result(state: LabState, event: ActionSucceeded) -> Iterator[Event]:
    """A result that does not fulfil the workflow's `expect` is an experiment error."""
    run = state.runs.active.get(event.run)
    plan = state.runs.plan_of(run) if run is not None else None
    expected = plan.steps[event.step].expect if plan is not None else None
    if run is None or plan is None or expected is None:
        return
    try:
        if holds(expected, sort_results_by_key(plan, find_results(plan, run)), event.result):
            return
        why = f"expected {expected.text}, the result is {_shorten(event.result)}"
    except ExpressionError as error:
        why = f"expected {expected.text}, which cannot be evaluated: {error.message.rstrip('.')}"
    yield StepUnexpected(run.id, event.step, f"step {plan.steps[event.step].key!r}: {why}")


def retry_step(state: LabState, event: ActionFailed) -> Iterator[Event]:
    """A step whose action failed is tried again, if its plan has a retry left and the effects so far allow
    it."""
    run = state.runs.active.get(event.run)
    if run is None or run.status == RunStatus.CANCELLING:
        return
    step = state.runs.plan_of(run).steps[event.step]
    number = run.steps[event.step].retries + 1
    if step.retry is None or number > step.retry.times:
        return
    if event.effects == "none" or can_be_repeated(step):
        why = _describe_failure(step, event)
        yield StepRetried(run.id, event.step, number, step.retry.times, step.retry.delay_s, why)


def handle_failure(state: LabState, event: ActionFailed | ActionRejected | StepUnexpected) -> Iterator[Event]:
    """A failed step without further retries is handled as its plan says: a person is asked, its recovery
    starts, it is skipped, or its run ends as failed."""
    run = state.runs.active.get(event.run)
    if run is None or run.steps[event.step].status != FAILED:
        return
    plan, step = state.runs.plan_of(run), event.step
    why, kind = _describe_failure(plan.steps[step], event), "software"
    if isinstance(event, ActionFailed):
        effects, kind = event.effects, event.kind
    elif isinstance(event, ActionRejected):
        effects = "none"
    else:
        effects, kind = "none" if is_inert(plan, step) else "all", "experiment"
    tried_again = reset_by(plan, step)
    if tried_again is not None:
        # A reset that fails counts as another failure of the step that it serves.
        step, effects = tried_again, "none"
    policy = plan.steps[step].on_error
    if policy is None or effects not in ("none", "all") or run.status == RunStatus.CANCELLING:
        yield from fail_run(state, run, why, kind)
    elif policy.do == "ask":
        yield _ask_about_step(state, run, step, effects, why)
    elif policy.do == "run":
        yield StepRecovering(run.id, step, why)
    elif policy.do == "skip" and (policy.may_skip or effects == "all"):
        yield StepSkipped(run.id, step, why)
    else:
        yield from fail_run(state, run, why, kind)


def fail_spoilt(state: LabState, event: ActionReconciled) -> Iterator[Event]:
    """A run ends as failed if the labware of an action was spoilt or taken off the bench."""
    run = state.runs.active.get(event.run)
    if run is not None and run.steps[event.step].status == FAILED:
        name = state.runs.plan_of(run).steps[event.step].action
        yield from fail_run(state, run, f"{name!r} on {local(event.module)} was spoilt ({event.by})")


def _describe_failure(step: PlanStep, event: ActionFailed | ActionRejected | StepUnexpected) -> str:
    """Why a step failed, as text for people."""
    if isinstance(event, StepUnexpected):
        return event.why
    if isinstance(event, ActionRejected):
        return f"{local(event.module)} refused {step.action!r}: {event.why}"
    return f"{local(event.module)} could not {step.action!r}: {event.error}"


def _shorten(result: Any) -> str:
    text = encode_canonical(result).decode()
    return text if len(text) <= 200 else f"{text[:199]}…"


def reset_by(plan: Plan, step: int) -> int | None:
    """The step whose module this step resets before a retry; None if it is not such a reset."""
    served = plan.steps[step].serves
    retry = plan.steps[served].retry if served is not None else None
    return served if retry is not None and retry.reset == step else None


def _ask_about_step(
    state: LabState, run: RunState, index: int, effects: EffectsDone, why: str
) -> InterventionRequested:
    """The question to a person about a step that failed."""
    step = state.runs.plan_of(run).steps[index]
    policy = step.on_error
    topic = FailedStep(
        run=run.id,
        module=step.module,
        step=index,
        done=effects == "all",
        again=effects == "none",
        may_skip=policy is not None and policy.may_skip,
    )
    return state.interventions.ask(
        topic,
        f"Run {run.id} ({run.workflow}), step {step.key!r}: {why.rstrip('.')}. The following steps wait.",
    )


def answer_failed(state: LabState, topic: FailedStep, choice: str, by: str) -> Iterator[Event]:
    """The events that follow when a person decides about a run whose step failed."""
    run = state.runs.active.get(RunId(topic.run))
    if run is None or run.status == RunStatus.CANCELLING:
        return
    index = topic.step
    step = state.runs.plan_of(run).steps[index]
    if choice == "retry":
        number = run.steps[index].retries + 1
        times = max(number, step.retry.times if step.retry is not None else 0)
        yield StepRetried(run.id, index, number, times, 0.0, f"{by} reported it")
    elif choice == "skip":
        yield StepSkipped(run.id, index, f"{by} reported it")
    else:
        yield from give_up(state, run, f"step {step.key!r} failed and was given up by {by}", "software")


def can_be_repeated(step: PlanStep) -> bool:
    """Whether a step may be repeated although its progress is unknown. This is so if its driver allows it, it
    carries nothing, and it does not change anything that it needs itself."""
    if not step.safe_to_repeat or list_carried(step.effects):
        return False
    changed = {(e.of, e.variable) for e in step.effects if isinstance(e, Sets)}
    needed = {(e.of, e.variable) for e in step.effects if isinstance(e, Requires)}
    return changed.isdisjoint(needed)
