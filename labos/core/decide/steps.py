"""What follows for a step when its action has failed."""

from __future__ import annotations

from labos.core.actions import Action, EffectsDone
from labos.core.effects import Move, Requires, Sets, Take
from labos.core.model import PlanStep
from labos.core.registry import Event
from labos.core.runs import RunState, StepRetried
from labos.core.state import LabState


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


__all__ = ["can_be_repeated", "retrying"]
