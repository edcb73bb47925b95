"""What follows for a step when its action has failed, or does not end."""

from __future__ import annotations

from labos.core.actions import Action, ActionUnknown, EffectsDone
from labos.core.decide._base import Command, Decision, decides
from labos.core.decide.outcomes import question_about, uncertain
from labos.core.effects import Move, Requires, Sets, Take
from labos.core.ids import ActionId
from labos.core.model import PlanStep
from labos.core.registry import Event
from labos.core.rules import due_at
from labos.core.runs import RunState, StepRetried
from labos.core.state import LabState


class TimeOutAction(Command, frozen=True):
    """An action has not ended in the time that its step gives it."""

    action: ActionId
    now: int


@decides(TimeOutAction)
def time_out_action(state: LabState, command: TimeOutAction) -> Decision:
    action = state.actions.open.get(command.action)
    due = due_at(state, action) if action is not None else None
    if action is None or due is None or command.now <= due:
        return []
    step = state.runs.plan_of(state.runs.active[action.run]).steps[action.step]
    return doubting(state, action, f"it did not end within {step.timeout_s:g} s")


def doubting(state: LabState, action: Action, why: str) -> list[Event]:
    """What follows when nobody can say how an action ended."""
    ids = (action.id, action.run, action.step, action.module, action.attempt)
    events: list[Event] = [ActionUnknown(*ids, why)]
    events += [uncertain(action, effect, why) for effect in action.effects if isinstance(effect, Move)]
    return [*events, question_about(state, action, why)]


def retrying(state: LabState, run: RunState, action: Action, effects: EffectsDone, why: str) -> list[Event]:
    """The step's next try, if its plan gives it one; else nothing."""
    step = state.runs.plan_of(run).steps[action.step]
    number = run.retries.get(str(action.step), 0) + 1
    if step.retry is None or number > step.retry.times or run.status == "cancelling":
        return []
    if effects != "none" and not can_be_repeated(step):
        return []
    return [StepRetried(run.id, action.step, number, step.retry.times, step.retry.delay_s, why)]


def can_be_repeated(step: PlanStep) -> bool:
    """Whether a step may be done again after nobody knows how far it went: its driver says so, it
    carries nothing, and it changes nothing that it needs itself."""
    if not step.safe_to_repeat or any(isinstance(effect, Move | Take) for effect in step.effects):
        return False
    changed = {(e.of, e.variable) for e in step.effects if isinstance(e, Sets)}
    needed = {(e.of, e.variable) for e in step.effects if isinstance(e, Requires)}
    return changed.isdisjoint(needed)


__all__ = ["TimeOutAction", "can_be_repeated", "doubting", "retrying"]
