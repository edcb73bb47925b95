"""A person's hands on a simulated bench: what an answer says has been put right is put right there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from labos.core.effects import Move, moved
from labos.core.ids import ActionId, InterventionId, LabwareId, StationName, local, workcell_of
from labos.core.interventions import Intervention
from labos.core.labware import LabwareRemoved
from labos.core.registry import Event
from labos.core.state import LabState
from labos.core.topics import LostLabware, UnknownAction
from labos.node.world import FLOOR, World
from labos.services.truth import bench_name

if TYPE_CHECKING:
    from labos.http.service import LabService

ENDS = {"done": "target", "target": "target", "not_done": "source", "source": "source", "gone": ""}
"""Where labware of a motion is that an answer tells of."""

AWAY = {"failed_run": ("removed",), "contradiction": ("removed", "gone")}
"""The answers by which somebody has carried labware away, by kind of question."""


def put_right(service: LabService, name: InterventionId, choice: str, events: Sequence[Event]) -> None:
    """Labware that a device still holds, has put down half-way or let fall is taken from there and put where
    the answer says. What stands at its start or its end is left alone: of that an answer only tells. Labware
    of which the answer says that it was carried away is carried away: what ``events``, which the answer will
    cause, remove."""
    state = service.kernel.state
    question = state.interventions.open.get(name)
    if question is None:
        return
    if choice in AWAY.get(question.kind, ()):
        _carry_away(service, state, question, events)
    if choice not in ENDS:
        return
    for effect in _motions(state, question):
        world = service.parts.world(workcell_of(effect.source))
        plate = _astray(world, state, question, effect)
        end = {"source": effect.source, "target": effect.target}.get(ENDS[choice])
        if plate:
            world.carry(plate, _place(state, end) if end else "")


def _carry_away(
    service: LabService, state: LabState, question: Intervention, events: Sequence[Event]
) -> None:
    """What leaves the record leaves the simulated bench; and what was seen at a place where the record knows
    nothing of it."""
    found: list[tuple[World, str]] = []
    for event in events:
        item = state.bench.labware.get(event.labware) if isinstance(event, LabwareRemoved) else None
        if item is not None and item.station in state.bench.stations:
            world = service.parts.world(workcell_of(item.station))
            found.append((world, plate_of(world, state, item.id)))
    station = state.bench.stations.get(StationName(question.subject))
    if station is not None and station.spec.capacity == 1:
        world = service.parts.world(workcell_of(station.spec.name))
        seen = world.at(bench_name(station.spec))
        known = station.count if not any(isinstance(event, LabwareRemoved) for event in events) else 0
        found += [(world, plate) for plate in seen[known:]]
    for world, plate in dict.fromkeys(found):
        if plate:
            world.carry(plate, "")


def plate_of(world: World, state: LabState, labware: LabwareId) -> str:
    """The simulated plate that the log calls by this name; empty if it is not where the log thinks."""
    station = state.bench.stations[state.bench.labware[labware].station]
    if labware not in station.labware:
        return ""
    plates = world.at(bench_name(station.spec))
    place = len(station.stock) + station.labware.index(labware)
    return plates[place] if place < len(plates) else ""


def _motions(state: LabState, question: Intervention) -> list[Move]:
    """The motions asked about whose devices are at rest: those that ended half-way, and those whose labware a
    device itself has said that it holds."""
    action = state.actions.open.get(ActionId(question.subject))
    if isinstance(question.topic, LostLabware):
        effects = question.motions
    else:
        effects = action.effects if isinstance(question.topic, UnknownAction) and action is not None else ()
    moves = [move for move in moved(effects) if not move.lid]
    return [e for e in moves if isinstance(question.topic, LostLabware) or _is_held(state, e.labware)]


def _is_held(state: LabState, name: LabwareId) -> bool:
    item = state.bench.labware.get(name)
    return item is not None and not item.maybe and state.bench.stations[item.station].spec.kind == "gripper"


def _astray(world: World, state: LabState, question: Intervention, effect: Move) -> str:
    """What a device still holds, has put down half-way or let fall; empty if there is nothing. What it
    carries meanwhile for somebody else is none of that."""
    device = local(question.module)
    others = [
        a for a in state.actions.open.values() if a.module == question.module and a.id != question.subject
    ]
    via = state.bench.stations.get(effect.via)
    places = [] if others else [f"hand:{device}"]
    if via is not None and not via.labware:
        places.append(bench_name(via.spec))
    for place in places:
        for plate in world.at(place):
            return plate
    fallen = [motion.plate for motion in world.motions("drop") if motion.device == device]
    return next((plate for plate in world.at(FLOOR) if plate in fallen), "")


def _place(state: LabState, station: StationName) -> str:
    """What the bench calls a station; nothing for a waste, where things leave it."""
    spec = state.bench.stations[station].spec
    return "" if spec.kind == "waste" else bench_name(spec)
