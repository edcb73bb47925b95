"""Questions of the lab to people, and their answers, as the log shows them."""

from __future__ import annotations

import msgspec

from labos.core.effects import list_moved
from labos.core.ids import ActionId, LabwareId, local
from labos.core.interventions import (
    Intervention,
    InterventionOverdue,
    InterventionRequested,
    InterventionResolved,
)
from labos.core.plans import PlanRecorded
from labos.core.runs import RunSubmitted
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.topics import PlannedWork, UnknownAction
from labos.ports import LogQuery
from labos.services.log import Log, decode_events
from labos.services.times import show_time

TYPES = ("intervention", RunSubmitted.TYPE, PlanRecorded.TYPE)

WITHDRAWN = "withdrawn"
"""The choice in the log of a question that was auto-resolved."""


class PossibleAnswer(msgspec.Struct, frozen=True):
    """A possible answer, its consequence, and the command that gives it."""

    name: str
    consequence: str
    command: str


class InterventionHistory(msgspec.Struct):
    """A question to a person. ``module`` is without its workcell; times in UTC ns, 0 for none;
    ``choice``, ``by`` and ``note`` are empty until it is answered."""

    id: str
    kind: str
    text: str
    subject: str
    run: str
    workflow: str
    module: str
    labware: tuple[str, ...]
    answers: tuple[PossibleAnswer, ...]
    requested_at: int
    due_at: int = 0
    overdue: bool = False
    choice: str = ""
    by: str = ""
    note: str = ""
    resolved_at: int = 0

    @property
    def open(self) -> bool:
        return not self.resolved_at

    @property
    def about(self) -> tuple[str, ...]:
        """The subjects of the question, by the names that other commands accept."""
        run = f"{self.run} ({self.workflow})" if self.workflow else self.run
        named = dict.fromkeys((run, self.module, *self.labware))
        return tuple(name for name in named if name) or (local(self.subject),)


def list_intervention_histories(log: Log) -> dict[str, InterventionHistory]:
    """Every question of the log, in the order in which they were asked. Raises LogTooNew, LogDamaged."""
    histories: dict[str, InterventionHistory] = {}
    plans: dict[str, str] = {}
    workflows: dict[str, str] = {}
    for event, head in decode_events(log.select(LogQuery(types=TYPES))):
        match event:
            case PlanRecorded():
                plans[event.plan] = event.workflow
            case RunSubmitted():
                workflows[event.run] = plans.get(event.plan, "")
            case InterventionRequested():
                histories[event.intervention] = _begin_history(
                    event, workflows.get(event.run, ""), head.recorded_at
                )
            case InterventionOverdue():
                histories[event.intervention].overdue = True
            case InterventionResolved():
                story = histories[event.intervention]
                story.choice, story.by, story.note = event.choice, event.by, event.note
                story.resolved_at = head.recorded_at
    return histories


def describe_answer(log: Log, name: str) -> str:
    """How a question was answered, as a sentence; empty if it does not exist, or if it is open. Raises
    LogTooNew, LogDamaged."""
    for event, head in decode_events(log.select(LogQuery(types=(InterventionResolved.TYPE,)))):
        if not isinstance(event, InterventionResolved) or event.intervention != name:
            continue
        at = show_time(head.recorded_at)
        note = f" ({event.note})" if event.note else ""
        if event.choice == WITHDRAWN:
            return f"{name} was auto-resolved at {at}{note}."
        return f"{event.by} answered {name} at {at}: {event.choice}{note}."
    return ""


def describe_whereabouts(state: LabState, question: Intervention) -> str:
    """Where the labware of a motion is now, as far as the lab knows: it may have been observed since the
    question was asked. Empty if the question is not about a motion."""
    action = state.actions.open.get(ActionId(question.subject))
    is_unknown = isinstance(question.topic, UnknownAction) and action is not None
    effects = action.effects if action is not None and is_unknown else question.motions
    names = [move.labware for move in list_moved(effects)]
    return "; ".join(_place(state, name) for name in names if name in state.bench.labware)


def _place(state: LabState, name: LabwareId) -> str:
    item = state.bench.labware[name]
    if item.maybe:
        return f"{name} may be at: {', '.join(local(place) or 'off the bench' for place in item.maybe)}"
    return f"{name} was observed at {local(item.station)}"


def _begin_history(event: InterventionRequested, workflow: str, at: int) -> InterventionHistory:
    return make_from(
        InterventionHistory,
        event,
        id=event.intervention,
        workflow=workflow,
        module=local(event.module),
        labware=tuple(event.labware),
        answers=tuple(
            PossibleAnswer(choice.name, choice.consequence, _command(event, choice.name))
            for choice in event.choices
        ),
        requested_at=at,
    )


def _command(event: InterventionRequested, choice: str) -> str:
    """The command for this answer. Planned work is confirmed, every other question is resolved."""
    if event.kind != PlannedWork.KIND:
        return f"labos resolve {event.intervention} {choice}"
    return f"labos confirm {event.intervention}{'' if choice == 'done' else ' --not-done'}"
