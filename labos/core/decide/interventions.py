"""A person answers."""

from __future__ import annotations

from typing import Any

from labos.core.actions import Action
from labos.core.bench import Labware, removal
from labos.core.decide._base import Command, Decision, Rejection, decides
from labos.core.decide.actions import FinishAction, finishing
from labos.core.decide.barcodes import settle_barcode
from labos.core.decide.doubts import OUTRANKED_NODE
from labos.core.decide.experiments import close_experiment, give_up_closing
from labos.core.decide.observation import settle_sight
from labos.core.decide.outcomes import LARGEST_RESULT, found_again, kept, read_later, settle
from labos.core.decide.runs import answer_late
from labos.core.decide.shorter import compared
from labos.core.decide.steps import answer_failed
from labos.core.decide.windows import FAILED_STEP, LATE_STEP
from labos.core.effects import Move, Relid, Unlid, arrivals
from labos.core.holding import used_meanwhile
from labos.core.ids import ActionId, ExperimentId, InterventionId, ModuleName, RunId, StationName, local
from labos.core.interventions import CLOSING_WAITS, PLANNED_WORK, Intervention, InterventionResolved
from labos.core.labware import LabwareObserved, LabwarePlaced
from labos.core.modules import ModulePutBack
from labos.core.registry import Event
from labos.core.rules import may_still_act
from labos.core.shorter import LOG_SHORTER
from labos.core.state import LabState


class ResolveIntervention(Command, frozen=True):
    """Choose one of an intervention's choices. ``by`` is the person's actor id; ``result`` is what
    a step that was done has measured, if later steps read it."""

    intervention: InterventionId
    choice: str
    by: str
    note: str = ""
    result: Any = None


@decides(ResolveIntervention)
def resolve_intervention(state: LabState, command: ResolveIntervention) -> Decision:
    question = state.interventions.open.get(command.intervention)
    if question is None:
        return Rejection("no_intervention", f"No intervention {command.intervention} waits for an answer.")
    names = [choice.name for choice in question.choices]
    if command.choice not in names:
        return Rejection(
            "no_choice",
            f"{command.choice!r} is no answer to {command.intervention}.",
            f"Choose one of: {', '.join(names)}.",
        )
    follows = _follows(state, question, command)
    if isinstance(follows, Rejection):
        return follows
    return [
        InterventionResolved(command.intervention, command.choice, command.by, command.note),
        *follows,
    ]


def _follows(
    state: LabState, question: Intervention, command: ResolveIntervention
) -> list[Event] | Rejection:
    if question.kind == "unknown_action":
        action = state.actions.open.get(ActionId(question.subject))
        return [] if action is None else _settled(state, action, command)
    if question.kind == PLANNED_WORK:
        action = state.actions.open.get(ActionId(question.subject))
        return [] if action is None else _confirmed(state, action, command)
    if question.kind == "lost_labware":
        return _found(state, question, command)
    if question.kind == "barcode":
        return settle_barcode(state, question, command.choice, command.by)
    if question.kind == "contradiction" and question.motions:
        return _with_room(state, settle_sight(state, question, command.choice, command.by))
    if question.kind == "failed_run" and command.choice == "removed":
        return [
            event
            for name in question.labware
            if name in state.bench.labware and not state.bench.labware[name].moving
            for event in removal(state.bench, name, "", StationName(""), f"taken away ({command.by})")
        ]
    if question.kind == FAILED_STEP:
        return answer_failed(state, question, command.choice, command.by)
    if question.kind == LATE_STEP:
        return answer_late(state, question, command.choice)
    if question.kind == CLOSING_WAITS and command.choice == "end":
        return give_up_closing(state, RunId(question.run), question.id)
    if question.kind == OUTRANKED_NODE:
        return [ModulePutBack(ModuleName(question.module))]
    if question.kind == LOG_SHORTER:
        return compared(state, command.by, command.note)
    if question.kind == "lost_experiment" and command.choice == "close":
        experiment = state.campaigns.experiments.get(ExperimentId(question.subject))
        if experiment is not None and experiment.runs:
            return Rejection(
                "runs_alive",
                f"The experiment {experiment.id} still has runs: {', '.join(experiment.runs)}.",
                "Wait for them or cancel them first.",
            )
        return close_experiment(state, ExperimentId(question.subject), "its application was lost")
    return []


def _confirmed(state: LabState, action: Action, command: ResolveIntervention) -> list[Event] | Rejection:
    """Planned work ends by a person's word, whatever its node knows."""
    done = command.choice == "done"
    unfit = _unfit_result(state, action, command) if done else None
    why = f"{command.by} says that it cannot be done{f': {command.note}' if command.note else ''}"
    end = FinishAction(action.id, action.attempt, True, "all", command.result)
    failed = FinishAction(action.id, action.attempt, False, "none", error=why)
    return unfit or finishing(state, action, end if done else failed)


def _settled(state: LabState, action: Action, command: ResolveIntervention) -> list[Event] | Rejection:
    if may_still_act(state, action):
        module = local(action.module)
        return Rejection(
            "node_gone",
            f"The node of {module} is away. It may still be at it, and will tell when it is back.",
            f"Start it again, or switch the device off, say so (labos out-of-service {module}), then answer.",
        )
    if command.choice != "done":
        taken = _source_taken(state, action) if command.choice == "not_done" else None
        return taken or settle(state, action, command.choice, command.by)
    unfit = _unfit_result(state, action, command)
    return unfit or settle(state, action, command.choice, command.by, command.result)


def _source_taken(state: LabState, action: Action) -> Rejection | None:
    """Why labware cannot be put back that was seen elsewhere meanwhile: others were let in there."""
    for effect in action.effects:
        if not isinstance(effect, Move) or isinstance(effect, Unlid | Relid):
            continue
        item = state.bench.labware.get(effect.labware)
        if item is None or effect.source in (item.station, *item.maybe):
            continue
        other = used_meanwhile(state, effect.source, state.runs.active[action.run])
        if other:
            seen = f"was seen at {local(item.station)}" if item.station else "was not seen there"
            return Rejection(
                "occupied",
                f"{effect.labware} {seen}, and {other} was let in to {local(effect.source)} meanwhile.",
                f"Put it at {local(effect.target)} and answer done, or take it away and answer gone.",
            )
    return None


def _unfit_result(state: LabState, action: Action, command: ResolveIntervention) -> Rejection | None:
    """Why later steps, or the log, could not do with the result that was told."""
    if command.result is None and read_later(state, action):
        return Rejection(
            "result_needed",
            f"Later steps of {action.run} read the result of {action.name!r} on {local(action.module)}.",
            "Say what it measured (--result JSON), or answer not_done to have it done again.",
        )
    if kept(command.result) != command.result:
        return Rejection(
            "too_large",
            f"The result has more than {LARGEST_RESULT} bytes.",
            "Give only what later steps read.",
        )
    return None


def _found(state: LabState, question: Intervention, command: ResolveIntervention) -> list[Event] | Rejection:
    return _with_room(state, found_again(state, question.motions, command.choice, command.by))


def _with_room(state: LabState, events: list[Event]) -> list[Event] | Rejection:
    stations = state.bench.stations
    for event in events:
        if not isinstance(event, LabwarePlaced | LabwareObserved) or event.station not in stations:
            continue
        place, station = event.station, stations[event.station]
        item = state.bench.labware.get(event.labware)
        if item is not None and item.on in station.labware:
            continue  # it lies on the plate there
        if isinstance(event, LabwarePlaced) and event.stack == place:
            continue  # it only gets its name there
        if station.count - _awaited(state, item, place) >= station.spec.capacity:
            held = ", ".join(station.labware) or "something is on its way there"
            return Rejection("occupied", f"{place} is full ({held}): the labware cannot stand there.")
    return events


def _awaited(state: LabState, item: Labware | None, place: StationName) -> bool:
    """Whether what is expected at a place is this very piece."""
    if item is None:
        return False
    effects = state.bench.reserved.get(ActionId(item.moving), ())
    way = arrivals(tuple(e for e in effects if isinstance(e, Move) and e.labware == item.id))
    return place in way or place in map(state.bench.planned, way)
