"""What follows for a step when its action has failed, or does not end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from labos.core.actions import Action, ActionUnknown, EffectsDone
from labos.core.branches import inert
from labos.core.canonical import canonical
from labos.core.conditions import by_key, holds
from labos.core.decide._base import Command, Decision, decides
from labos.core.decide.endings import Placement, conclude, giving_up
from labos.core.decide.outcomes import carried_off, question_about, uncertain
from labos.core.decide.waiting import asked_to_see_to, waits_no_more
from labos.core.decide.windows import FAILED_STEP
from labos.core.effects import Move, Requires, Sets, Take
from labos.core.expressions import ExpressionError
from labos.core.ids import ActionId, InterventionId, RunId
from labos.core.interventions import UNNUMBERED, Choice, Intervention, InterventionRequested
from labos.core.labware import LabwareUncertain
from labos.core.model import Plan, PlanStep
from labos.core.registry import Event
from labos.core.rules import NODE_AWAY_S, due_at, missed_at, stuck_at
from labos.core.runs import DONE, FAILED, SKIPPED, RunState
from labos.core.state import LabState
from labos.core.steps import StepRecovering, StepRetried, StepSkipped, StepUnexpected


class TimeOutAction(Command, frozen=True):
    """An action has not ended in the time that its step gives it, its node stays away, or its device stands
    still and says why."""

    action: ActionId
    now: int


@decides(TimeOutAction)
def time_out_action(state: LabState, command: TimeOutAction) -> Decision:
    action = state.actions.open.get(command.action)
    if action is None:
        return []
    due, missed = due_at(state, action), missed_at(state, action)
    if due is not None and command.now > due:
        step = state.runs.plan_of(state.runs.active[action.run]).steps[action.step]
        return doubting(state, action, f"it did not end within {step.timeout_s:g} s")
    if missed is not None and command.now > missed:
        return doubting(state, action, f"its node has been gone for {NODE_AWAY_S:g} s")
    stuck = stuck_at(state, action)
    return [asked_to_see_to(state, action)] if stuck is not None and command.now > stuck else []


def doubting(
    state: LabState, action: Action, why: str, maybe: Sequence[LabwareUncertain] | None = None
) -> list[Event]:
    """What follows when nobody can say how an action ended; ``maybe`` is where its labware may be, if more
    is known of that."""
    ids = (action.id, action.run, action.step, action.module, action.attempt)
    events: list[Event] = [ActionUnknown(*ids, why)]
    if maybe is None:
        seen = carried_off(state, action)
        moves = [e for e in action.effects if isinstance(e, Move) and e.labware not in seen]
        maybe = [uncertain(action, effect, why) for effect in moves]
    asked = waits_no_more(state, action.module, "it is not known what became of its action")
    return [*events, *maybe, question_about(action, why, maybe), *asked]


def retrying(state: LabState, run: RunState, action: Action, effects: EffectsDone, why: str) -> list[Event]:
    """The step's next try, if its plan gives it one; else nothing."""
    step = state.runs.plan_of(run).steps[action.step]
    number = run.retries.get(str(action.step), 0) + 1
    if step.retry is None or number > step.retry.times or run.status == "cancelling":
        return []
    if effects != "none" and not can_be_repeated(step):
        return []
    return [StepRetried(run.id, action.step, number, step.retry.times, step.retry.delay_s, why)]


def failing(
    state: LabState,
    run: RunState,
    step: int,
    effects: EffectsDone,
    why: str,
    extra: tuple[Placement, ...] = (),
    kind: str = "software",
) -> list[Event]:
    """What follows for a run when one of its steps failed and is not tried again."""
    plan = state.runs.plan_of(run)
    if resets(plan, step):
        # A module that cannot be reset is as good as another failure of the step it serves.
        step, effects = plan.steps[step].part, "none"
    policy = plan.steps[step].on_error
    if policy is None or effects not in ("none", "all") or run.status == "cancelling":
        return conclude(state, run, step, FAILED, why, extra, kind=kind)
    if policy.do == "ask":
        return [_question(run, plan, step, effects, why)]
    if policy.do == "run":
        return [StepRecovering(run.id, step, why)]
    if policy.do == "skip" and (policy.may_skip or effects == "all"):
        return _skipping(state, run, step, why, extra)
    return conclude(state, run, step, FAILED, why, extra, kind=kind)


def succeeding(
    state: LabState, run: RunState, step: int, result: Any, extra: tuple[Placement, ...] = ()
) -> list[Event]:
    """What follows for a run when the action of a step succeeded: its result may not be as expected."""
    plan = state.runs.plan_of(run)
    expected = plan.steps[step].expect
    if expected is None:
        return conclude(state, run, step, DONE, "", extra, result=result)
    try:
        fits = holds(expected, by_key(plan, run.results), result)
        why = "" if fits else f"expected {expected.text}, the result is {_short(result)}"
    except ExpressionError as error:
        why = f"expected {expected.text}, which cannot be decided: {error.message.rstrip('.')}"
    if not why:
        return conclude(state, run, step, DONE, "", extra, result=result)
    why = f"step {plan.steps[step].key!r}: {why}"
    done: EffectsDone = "none" if inert(plan, step) else "all"
    return [StepUnexpected(run.id, step, why), *failing(state, run, step, done, why, extra, "experiment")]


def _short(result: Any) -> str:
    text = canonical(result).decode()
    return text if len(text) <= 200 else f"{text[:199]}…"


def resets(plan: Plan, step: int) -> bool:
    """Whether a step is there to reset the module of another before it is tried again."""
    part = plan.steps[step].part
    retry = plan.steps[part].retry if part >= 0 else None
    return retry is not None and retry.reset == step


def _skipping(
    state: LabState,
    run: RunState,
    step: int,
    why: str,
    extra: tuple[Placement, ...] = (),
    answered: InterventionId = UNNUMBERED,
) -> list[Event]:
    follows = conclude(state, run, step, SKIPPED, why, extra, answered=answered)
    return [StepSkipped(run.id, step, why), *follows]


def _question(run: RunState, plan: Plan, step: int, effects: EffectsDone, why: str) -> InterventionRequested:
    """What a person is asked about a step that failed."""
    policy = plan.steps[step].on_error
    choices = [Choice("fail", "The run ends as failed; its labware stays where it is.")]
    if effects == "all":
        choices.insert(0, Choice("skip", "What it should do was done all the same: the run goes on."))
    elif policy is not None and policy.may_skip:
        choices.insert(0, Choice("skip", "The run goes on without it."))
    if effects == "none":
        choices.insert(0, Choice("retry", "It is done again."))
    return InterventionRequested(
        UNNUMBERED,
        FAILED_STEP,
        f"{run.id}#{step}",
        f"Run {run.id} ({run.workflow}), step {plan.steps[step].key!r}: {why.rstrip('.')}. "
        "What follows it waits.",
        tuple(choices),
        run=run.id,
        module=plan.steps[step].module,
    )


def answer_failed(state: LabState, question: Intervention, choice: str, by: str) -> list[Event]:
    """What follows when a person says what becomes of a run whose step failed."""
    run = state.runs.active.get(RunId(question.run))
    if run is None or run.status == "cancelling":
        return []
    index = int(question.subject.rpartition("#")[2])
    step = state.runs.plan_of(run).steps[index]
    if choice == "retry":
        number = run.retries.get(str(index), 0) + 1
        times = max(number, step.retry.times if step.retry is not None else 0)
        return [StepRetried(run.id, index, number, times, 0.0, f"{by} said so")]
    if choice == "skip":
        return _skipping(state, run, index, f"{by} said so", answered=question.id)
    why = f"step {step.key!r} failed and was given up by {by}"
    return giving_up(state, run, why, answered=question.id, kind="software")


def can_be_repeated(step: PlanStep) -> bool:
    """Whether a step may be done again after nobody knows how far it went: its driver says so, it
    carries nothing, and it changes nothing that it needs itself."""
    if not step.safe_to_repeat or any(isinstance(effect, Move | Take) for effect in step.effects):
        return False
    changed = {(e.of, e.variable) for e in step.effects if isinstance(e, Sets)}
    needed = {(e.of, e.variable) for e in step.effects if isinstance(e, Requires)}
    return changed.isdisjoint(needed)


__all__ = [
    "TimeOutAction",
    "answer_failed",
    "can_be_repeated",
    "doubting",
    "failing",
    "resets",
    "retrying",
    "succeeding",
]
