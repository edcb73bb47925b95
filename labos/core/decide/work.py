"""Planned work: a step that a person does and confirms.

Its action is requested like any other, but the node only knows that it is under way. It ends when a named
person confirms it, in one batch with its effects on the bench. A failure of the node or the kernel before
that has no effect.
"""

from __future__ import annotations

from typing import Any

from labos.core.actions import Action
from labos.core.decide._base import Decision, InnerCommand, decides
from labos.core.effects import AnyEffect, Move, Needs, Take
from labos.core.ids import ActionId, InterventionId, LabwareId, local
from labos.core.interventions import Intervention, InterventionOverdue, InterventionRequested
from labos.core.model import PlanStep
from labos.core.rules import convert_lab_s
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.core.topics import PlannedWork


class NoteOverdue(InnerCommand, frozen=True):
    """The due time of planned work has passed, and nobody has confirmed it."""

    intervention: InterventionId
    now: int


def ask_for_work(
    state: LabState,
    run: RunState,
    step: PlanStep,
    action: ActionId,
    args: dict[str, Any],
    effects: tuple[AnyEffect, ...],
    now: int,
) -> InterventionRequested:
    """The entry of the inbox for a step. It is due after the lab seconds in its argument ``within``, or after
    the step's nominal duration."""
    within = args.get("within")
    within_s = float(within) if isinstance(within, int | float) and within > 0 else step.duration_s
    what = "; ".join(
        filter(None, [*(_describe_effect(state, e) for e in effects), _describe_arguments(args)])
    )
    return state.interventions.ask(
        PlannedWork(run=run.id, module=step.module, action=action),
        f"{local(step.module)}, please: {what or step.action} ({step.key!r} of {run.id}).",
        now + convert_lab_s(state, within_s),
    )


def find_work(state: LabState, action: Action) -> Intervention | None:
    """The inbox entry of an action, if it is planned work."""
    question = state.interventions.find_about(action.id)
    return question if question is not None and isinstance(question.topic, PlannedWork) else None


@decides(NoteOverdue)
def note_overdue(state: LabState, command: NoteOverdue) -> Decision:
    question = state.interventions.open.get(command.intervention)
    if question is None or question.overdue or not 0 < question.due_at <= command.now:
        return []
    return [InterventionOverdue(question.id, question.run, question.due_at)]


def _describe_effect(state: LabState, effect: AnyEffect) -> str:
    match effect:
        case Move():
            what = _describe_labware(state, effect.labware)
            return f"carry {what} from {local(effect.source)} to {local(effect.target)}"
        case Take():
            return f"take {effect.labware} from {local(effect.stack)} to {local(effect.target)}"
        case Needs() if effect.labware:
            return f"with {_describe_labware(state, effect.labware)}"
    return ""


def _describe_labware(state: LabState, name: LabwareId) -> str:
    known = state.bench.labware.get(name)
    return f"{name} ({known.type})" if known is not None else str(name)


def _describe_arguments(args: dict[str, Any]) -> str:
    """The arguments as text, without places and times."""
    shown = {name: value for name, value in args.items() if name not in ("within", "source", "target")}
    if "instruction" in shown:
        return str(shown["instruction"])
    return ", ".join(f"{name} {value}" for name, value in shown.items() if value not in ("", None))
