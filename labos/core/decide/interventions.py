"""A person answers a question."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import chain
from typing import Any, assert_never

from labos.core.actions import Action
from labos.core.bench import Labware, remove_labware
from labos.core.decide._base import Command, Decision, Rejection, decides
from labos.core.decide.actions import FinishAction, finish
from labos.core.decide.barcodes import settle_barcode
from labos.core.decide.experiments import EndExperiment, end_experiment, end_without_closing
from labos.core.decide.observation import settle_sight
from labos.core.decide.outcomes import LARGEST_RESULT, is_read_later, limit_result, settle, settle_found
from labos.core.decide.proposals import answer_approval, answer_question
from labos.core.decide.runs import answer_late
from labos.core.decide.shorter import finish_round
from labos.core.decide.steps import answer_failed
from labos.core.effects import Move, Relid, Unlid, list_arrivals
from labos.core.holding import find_user_meanwhile
from labos.core.ids import ActionId, InterventionId, ModuleName, RunId, StationName, local
from labos.core.interventions import Intervention, InterventionResolved
from labos.core.labware import GONE, LabwareObserved, LabwarePlaced
from labos.core.modules import ModulePutBack
from labos.core.registry import Event
from labos.core.rules import may_still_act
from labos.core.state import LabState
from labos.core.topics import (
    Approval,
    Barcode,
    BookedPlace,
    ClosingWaits,
    DeviceWaits,
    DiscoveredAction,
    DoubtfulNode,
    FailedStep,
    LateResult,
    LateStep,
    LeftLabware,
    LostExperiment,
    LostLabware,
    NotSeen,
    OutrankedNode,
    PlannedWork,
    SecondPerson,
    SeenElsewhere,
    ShorterLog,
    Unexpected,
    UnknownAction,
)
from labos.core.words import Words


class ResolveIntervention(Command, frozen=True):
    """Choose one of an intervention's choices. ``by`` is the person's actor id. If later steps read the
    result of a step that was done, ``result`` is its measured value."""

    intervention: InterventionId
    choice: str
    by: str
    note: Words = ""
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
            f"{command.choice!r} is not a possible answer to {command.intervention}.",
            f"Choose one of: {', '.join(names)}.",
        )
    follows = _decide_answer(state, question, command)
    if isinstance(follows, Rejection):
        return follows
    resolved = InterventionResolved(command.intervention, command.choice, command.by, command.note)
    return chain([resolved], follows)


def _decide_answer(state: LabState, question: Intervention, command: ResolveIntervention) -> Decision:
    """The events that follow from each answer."""
    topic, choice, by = question.topic, command.choice, command.by
    match topic:
        case UnknownAction():
            action = state.actions.open.get(topic.action)
            return [] if action is None else _settle_unknown(state, action, command)
        case PlannedWork():
            action = state.actions.open.get(topic.action)
            return [] if action is None else _confirm(state, action, command)
        case LostLabware():
            return _expect_room(state, lambda: settle_found(state, topic.motions, choice, by))
        case Barcode():
            return settle_barcode(state, topic, choice, by)
        case NotSeen() | SeenElsewhere() | Unexpected():
            return _expect_room(state, lambda: settle_sight(state, topic, choice, by))
        case LeftLabware():
            return _clear_away(state, topic, by) if choice == "removed" else []
        case FailedStep():
            return answer_failed(state, topic, choice, by)
        case LateStep():
            return answer_late(state, topic, choice)
        case ClosingWaits():
            return end_without_closing(state, RunId(topic.run)) if choice == "end" else []
        case Approval():
            return answer_question(state, topic, choice, by, command.note)
        case SecondPerson():
            return answer_approval(state, topic, choice, by)
        case OutrankedNode():
            return [ModulePutBack(ModuleName(topic.module))]
        case ShorterLog():
            return finish_round(state, by, command.note)
        case LostExperiment():
            end = EndExperiment(topic.experiment, "its application was lost")
            return end_experiment(state, end) if choice == "close" else []
        case LateResult() | DiscoveredAction() | DoubtfulNode() | DeviceWaits() | BookedPlace() | None:
            return []  # nothing follows, except that a person has taken care of it
        case _:
            assert_never(topic)


def _clear_away(state: LabState, topic: LeftLabware, by: str) -> list[Event]:
    return [
        event
        for name in topic.labware
        if name in state.bench.labware and not state.bench.labware[name].moving
        for event in remove_labware(state.bench, name, "", GONE, f"taken away ({by})")
    ]


def _confirm(state: LabState, action: Action, command: ResolveIntervention) -> Decision:
    """Planned work ends when a person reports it, whatever its node reports."""
    done = command.choice == "done"
    unfit = _refuse_result(state, action, command) if done else None
    why = f"{command.by} reports that it cannot be done{(f': {command.note}' if command.note else '')}"
    end = FinishAction(action.id, action.attempt, True, "all", command.result)
    failed = FinishAction(action.id, action.attempt, False, "none", error=why)
    return unfit or finish(state, action, end if done else failed)


def _settle_unknown(state: LabState, action: Action, command: ResolveIntervention) -> Decision:
    if may_still_act(state, action):
        module = local(action.module)
        return Rejection(
            "node_gone",
            f"The node of {module} cannot be reached. It may still be working, and reports the "
            "outcome when it is back.",
            f"Start it again; or switch the device off, report that (labos out-of-service {module}), "
            "and then answer.",
        )
    if command.choice != "done":
        taken = _refuse_taken_source(state, action) if command.choice == "not_done" else None
        return taken or settle(state, action, command.choice, command.by)
    unfit = _refuse_result(state, action, command)
    return unfit or settle(state, action, command.choice, command.by, command.result)


def _refuse_taken_source(state: LabState, action: Action) -> Rejection | None:
    """Why labware that was seen elsewhere cannot be put back: its former place has been given to others."""
    for effect in action.effects:
        if not isinstance(effect, Move) or isinstance(effect, Unlid | Relid):
            continue
        item = state.bench.labware.get(effect.labware)
        if item is None or effect.source in (item.station, *item.maybe):
            continue
        other = find_user_meanwhile(state, effect.source, state.runs.active[action.run])
        if other:
            seen = f"was observed at {local(item.station)}" if item.station else "was not observed there"
            return Rejection(
                "occupied",
                f"{effect.labware} {seen}, and {other} has moved to {local(effect.source)} meanwhile.",
                f"Put it at {local(effect.target)} and answer `done`, or remove it and answer `gone`.",
            )
    return None


def _refuse_result(state: LabState, action: Action, command: ResolveIntervention) -> Rejection | None:
    """Why the reported result cannot be used by later steps, or cannot be recorded in the log."""
    if command.result is None and is_read_later(state, action):
        return Rejection(
            "result_needed",
            f"Later steps of {action.run} read the result of {action.name!r} on {local(action.module)}.",
            "Give the measured result (--result JSON), or answer `not_done` to have it done again.",
        )
    if limit_result(command.result) != command.result:
        return Rejection(
            "too_large",
            f"The result has more than {LARGEST_RESULT} bytes.",
            "Give only the values that later steps read.",
        )
    return None


def _expect_room(state: LabState, events: Callable[[], Iterable[Event]]) -> Decision:
    """Events that place labware, or a rejection if there is no room for it."""
    stations = state.bench.stations
    for event in events():
        if not isinstance(event, LabwarePlaced | LabwareObserved) or event.station not in stations:
            continue
        place, station = event.station, stations[event.station]
        item = state.bench.labware.get(event.labware)
        if item is not None and item.on in station.labware:
            continue  # it lies on the plate there
        if isinstance(event, LabwarePlaced) and event.stack == place:
            continue  # it only gets its id there
        if station.count - _is_awaited(state, item, place) >= station.spec.capacity:
            held = ", ".join(station.labware) or "other labware is on its way there"
            return Rejection("occupied", f"{place} is full ({held}): the labware cannot stand there.")
    return events()


def _is_awaited(state: LabState, item: Labware | None, place: StationName) -> bool:
    """Whether the arrival that is expected at a place is this piece."""
    if item is None:
        return False
    effects = state.bench.reserved.get(ActionId(item.moving), ())
    way = list_arrivals(tuple(e for e in effects if isinstance(e, Move) and e.labware == item.id))
    return place in way or place in map(state.bench.find_planned_place, way)
