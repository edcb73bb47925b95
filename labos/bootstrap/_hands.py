"""A simulated person at a simulated bench: the acts of people in the log are carried out on the simulated
bench.

At a real bench people act, and report it to the lab. At a simulated one nobody acts. So every recorded act of
a person is carried out as soon as its event is on disk, before a node gets a request that follows from it.
Acts whose events could not be written are not carried out.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from labos.core.effects import Move, Replaces, list_moved
from labos.core.fold import evolve_slices
from labos.core.ids import ActionId, LabwareId, ModuleName, StationName, local, workcell_of
from labos.core.interventions import Intervention, InterventionResolved
from labos.core.lab import AccessEnded, WorkcellApplied
from labos.core.labware import (
    LabwareChanged,
    LabwareObserved,
    LabwarePlaced,
    LabwareRemoved,
    StationDeclared,
    StationLoaded,
    StationObserved,
    StationUnloaded,
)
from labos.core.registry import Event, decode
from labos.core.resources import ResourceReplenished
from labos.core.shorter import StationsChecked
from labos.core.state import LabState
from labos.core.topics import LostLabware, UnknownAction
from labos.node.world import FLOOR, World
from labos.ports import EventStore
from labos.runtime.ledger import Entry
from labos.services.truth import bench_name

SLICES = frozenset({"lab", "modules", "bench", "actions", "resources", "interventions"})
"""The slices of the lab's state that the simulated person needs."""

ENDS = {"done": "target", "target": "target", "not_done": "source", "source": "source", "gone": ""}
"""The end of a motion at which its labware is, by the answer."""

AWAY = {"failed_run": ("removed",), "contradiction": ("removed", "gone")}
"""The answers that mean that a person has carried labware away, by kind of question."""

E = TypeVar("E", bound=Event)


class SimulatedHands:
    """A listener of the kernel, the first of all. ``state`` is the state of the lab on disk; ``world``
    returns the simulated bench of a workcell. Its state is one command behind, because it needs the place of
    a piece before the piece was taken away."""

    def __init__(self, world: Callable[[str], World], log: EventStore, state: LabState) -> None:
        self._world, self._log = world, log
        self._state = LabState(position=state.position)
        for name in SLICES:
            setattr(self._state, name, copy.deepcopy(getattr(state, name)))
        for cell in self._state.lab.workcells:
            _furnish(self._world(cell), self._state, cell)

    def on_committed(self, entries: Sequence[Entry]) -> None:
        fresh = [entry for entry in entries if entry.position > self._state.position]
        if fresh and fresh[0].position > self._state.position + 1:
            self.on_reopened()  # it has all of them
        else:
            self._follow(fresh)

    def on_reopened(self) -> None:
        """The log may have events that no listener has received."""
        records = self._log.read(after=self._state.position)
        self._follow([Entry(r, decode(r.head.type, r.head.schema, r.payload)) for r in records])

    def _follow(self, entries: Sequence[Entry]) -> None:
        for command in _group_by_command(entries):
            events = [entry.event for entry in command]
            try:
                if command[0].record.head.actor not in self._state.modules.by_name:
                    self._do(events)
            finally:
                for entry in command:
                    evolve_slices(
                        self._state, SLICES, entry.event, entry.position, entry.record.head.recorded_at
                    )
            for applied in _list_events(events, WorkcellApplied):
                _furnish(self._world(applied.name), self._state, applied.name)

    def _do(self, events: Sequence[Event]) -> None:
        """Carry out the acts of people in the events of one command."""
        answers = [each for each in _list_events(events, InterventionResolved) if each.choice != "withdrawn"]
        if answers:
            for answer in answers:
                self._put_right(answer, events)
        elif any(isinstance(event, AccessEnded) for event in events):
            self._change_stations(events)
        elif not any(isinstance(event, StationObserved | StationsChecked) for event in events):
            # A person who only observed or counted has moved nothing.
            self._unload(events)
            self._load(events)
            for event in _list_events(events, ResourceReplenished):
                self._supply(event)

    def _find_world(self, station: StationName) -> World:
        return self._world(workcell_of(station))

    # -- bringing and taking away ------------------------------------------------------------

    def _load(self, events: Sequence[Event]) -> None:
        lids = {event.on: event.type for event in _list_events(events, LabwarePlaced) if event.on}
        declared = {event.station for event in _list_events(events, StationDeclared)}
        places: dict[LabwareId, StationName] = {}
        for event in events:
            match event:
                case StationDeclared():
                    world, place = self._find_world(event.station), local(event.station)
                    for kind in event.contents[len(world.at(place)) :]:
                        world.stock(place, kind)
                case StationLoaded():
                    self._find_world(event.station).stock(local(event.station), event.type, event.count)
                case LabwarePlaced() if not (event.run or event.on or event.action):
                    places[event.labware] = event.station
                    world, place = self._find_world(event.station), local(event.station)
                    brought = sum(where == event.station for where in places.values())
                    if event.station in declared and len(world.at(place)) >= brought:
                        continue  # it was there before; it is only mentioned now
                    lid = lids.get(event.labware)
                    world.stock(place, f"{event.type}+{lid}" if lid else event.type)
                case LabwareChanged(variable="sealed", value=True) if event.labware in places:
                    station = places[event.labware]
                    self._find_world(station).work("person", "seal", local(station))

    def _unload(self, events: Sequence[Event]) -> None:
        plates: list[tuple[World, str]] = []
        stations = self._state.bench.stations
        for event in events:
            match event:
                case LabwareRemoved() if not (event.run or event.action):
                    place = self._state.bench.labware[event.labware].station
                    if place:
                        world = self._find_world(place)
                        plates.append((world, _plate_of(world, self._state, event.labware)))
                case StationUnloaded():
                    world, station = self._find_world(event.station), stations[event.station]
                    if station.spec.kind != "waste":
                        top = len(station.stock)
                        nameless = world.at(local(event.station))[top - event.count : top]
                        plates += [(world, plate) for plate in nameless]
                    elif event.count >= station.level:
                        world.empty(local(event.station))
        _carry_away(plates)

    def _supply(self, event: ResourceReplenished) -> None:
        world, device = self._world(workcell_of(event.module)), local(event.module)
        had = world.find_level(device, event.resource) or 0.0 if event.instead else 0.0
        world.supply(device, event.resource, event.amount - had)

    # -- reaching in -------------------------------------------------------------------------

    def _change_stations(self, events: Sequence[Event]) -> None:
        """Make the changes of a person who reached in, unless the bench is already as reported."""
        state = self._state
        plates = {
            event.labware: _plate_of(self._find_world(event.station), state, event.labware)
            for event in _list_events(events, LabwareObserved)
        }
        for cleared in _list_events(events, StationDeclared):
            world = self._find_world(cleared.station)
            standing = world.at(bench_name(state.bench.stations[cleared.station].spec))
            _carry_away([(world, plate) for plate in standing if plate not in plates.values()])
        for event in events:
            if not isinstance(event, LabwareObserved | LabwarePlaced):
                continue
            station, world = state.bench.stations[event.station], self._find_world(event.station)
            place = bench_name(station.spec)
            if isinstance(event, LabwarePlaced):
                if len(world.at(place)) <= len(station.labware):
                    world.stock(place, event.type)
            elif (plate := plates[event.labware]) and plate not in world.at(place):
                world.carry(plate, place)

    # -- answers -----------------------------------------------------------------------------

    def _put_right(self, answer: InterventionResolved, events: Sequence[Event]) -> None:
        """Labware that a device still holds, has put down half-way or dropped is taken from there, and put at
        the place in the answer. Labware at the start or the end of its motion is not moved: the answer only
        reports its place. Labware that was carried away, according to ``events``, is carried away."""
        state, choice = self._state, answer.choice
        question = state.interventions.open[answer.intervention]
        if choice in AWAY.get(question.kind, ()):
            self._clear_away(question, list(_list_events(events, LabwareRemoved)))
        if choice not in ENDS:
            return
        for effect in _list_motions(state, question):
            world = self._find_world(effect.source)
            plate = _find_displaced(world, state, question, effect)
            end = {"source": effect.source, "target": effect.target}.get(ENDS[choice])
            if plate:
                world.carry(plate, _place(state, end) if end else "")
        if choice == "done":
            self._refill(question)

    def _clear_away(self, question: Intervention, removed: Sequence[LabwareRemoved]) -> None:
        """Remove labware from the bench that was removed from the record, and labware that was seen at a
        place that is empty in the record."""
        state = self._state
        plates: list[tuple[World, str]] = []
        for event in removed:
            item = state.bench.labware[event.labware]
            if item.station:
                world = self._find_world(item.station)
                plates.append((world, _plate_of(world, state, item.id)))
        station = state.bench.stations.get(StationName(question.subject))
        if station is not None and station.spec.capacity == 1:
            world = self._find_world(station.spec.name)
            recorded = 0 if removed else station.count
            plates += [(world, plate) for plate in world.at(bench_name(station.spec))[recorded:]]
        _carry_away(plates)

    def _refill(self, question: Intervention) -> None:
        """A resource that a person was asked to replace is full when this is confirmed."""
        action = self._state.actions.open.get(ActionId(question.subject))
        for effect in action.effects if action is not None else ():
            if not isinstance(effect, Replaces):
                continue
            module = ModuleName(effect.module)
            level = self._state.resources.find(module, effect.resource)
            if level is not None:
                world, device = self._world(workcell_of(module)), local(module)
                left = world.find_level(device, effect.resource) or 0.0
                world.supply(device, effect.resource, level.capacity - left)


def _group_by_command(entries: Sequence[Entry]) -> Iterator[list[Entry]]:
    """The events, grouped by command: the first event of a command is the cause of the others."""
    command: list[Entry] = []
    for entry in entries:
        head = entry.record.head
        first = command[0].record.head if command else head
        if command and (head.causation, head.actor) != (first.id, first.actor):
            yield command
            command = []
        command.append(entry)
    if command:
        yield command


def _list_events(events: Sequence[Event], kind: type[E]) -> Iterator[E]:
    return (event for event in events if isinstance(event, kind))


def _carry_away(plates: Sequence[tuple[World, str]]) -> None:
    for world, plate in dict.fromkeys(plates):
        if plate:
            world.carry(plate, "")


def _furnish(world: World, state: LabState, cell: str) -> None:
    """Set up the simulated bench as in the workcell's file; labware that is there stays."""
    zones: dict[str, str] = {}
    for name in state.bench.in_cell.get(cell, ()):
        spec = state.bench.stations[name].spec
        zones[local(name)] = spec.zone
        if name not in state.bench.shelves and not world.is_furnished(local(name)):
            world.furnish(local(name), spec.capacity)
    for device, module in state.modules.list_in_cell(cell):
        zones[local(device)] = module.spec.zone
        for resource, capacity in module.spec.levels.items():
            if world.find_level(local(device), resource) is None:
                world.supply(local(device), resource, capacity)
    for place, zone in zones.items():
        if zone:
            world.share(zone, place)


def _plate_of(world: World, state: LabState, labware: LabwareId) -> str:
    """The simulated plate for labware of the log; empty if it is not at the place in the log."""
    station = state.bench.stations.get(state.bench.labware[labware].station)
    if station is None or labware not in station.labware:
        return ""
    plates = world.at(bench_name(station.spec))
    place = len(station.stock) + station.labware.index(labware)
    return plates[place] if place < len(plates) else ""


def _list_motions(state: LabState, question: Intervention) -> list[Move]:
    """The motions in a question whose devices are at rest: those that ended half-way, and those whose labware
    is held by a device according to its own report."""
    action = state.actions.open.get(ActionId(question.subject))
    if isinstance(question.topic, LostLabware):
        effects = question.motions
    else:
        effects = action.effects if isinstance(question.topic, UnknownAction) and action is not None else ()
    moves = [move for move in list_moved(effects) if not move.lid]
    return [e for e in moves if isinstance(question.topic, LostLabware) or _is_held(state, e.labware)]


def _is_held(state: LabState, name: LabwareId) -> bool:
    item = state.bench.labware.get(name)
    return item is not None and not item.maybe and state.bench.stations[item.station].spec.kind == "gripper"


def _find_displaced(world: World, state: LabState, question: Intervention, effect: Move) -> str:
    """The plate of a motion that a device still holds, has put down half-way or dropped; empty if there is
    none. Plates that it carries for other actions do not count."""
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
    """The bench's name of a station; empty for a waste, where labware leaves the bench."""
    spec = state.bench.stations[station].spec
    return "" if spec.kind == "waste" else bench_name(spec)
