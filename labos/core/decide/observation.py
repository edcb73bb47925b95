"""An observation of a station: it reduces uncertainty, and a contradiction to the log opens a question."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain
from typing import assert_never

from labos.core.actions import Action, ActionStatus
from labos.core.bench import Labware, StationState
from labos.core.decide._base import Command, Decision, Rejection, refuse_hotel
from labos.core.decide.barcodes import find_uncertain
from labos.core.decide.lookups import decides_about, expect_labware, expect_station
from labos.core.decide.outcomes import find_shown_outcome, is_read_later, settle
from labos.core.effects import list_carried, list_moved, list_places, name_hand
from labos.core.ids import SHARED, ActionId, LabwareId, StationName, local
from labos.core.interventions import Intervention
from labos.core.labware import (
    GONE,
    LabwareObserved,
    LabwarePlaced,
    LabwareRemoved,
    LabwareUncertain,
    StationObserved,
)
from labos.core.registry import Event
from labos.core.rules import may_still_act
from labos.core.state import LabState
from labos.core.topics import (
    Contradiction,
    LabwareInDoubt,
    LeftLabware,
    LostLabware,
    NotSeen,
    SeenElsewhere,
    Unexpected,
    UnknownAction,
    name_some,
    split_into_batches,
)


class ObserveStation(Command, frozen=True):
    """Report an observation of a station: a number of pieces (``count``; 0: it is empty; null: at least
    one), labware by its id, or labware of a type (``kind``). ``by`` is the person or the module that
    observed it."""

    station: StationName
    by: str
    count: int | None = None
    labware: LabwareId = LabwareId("")
    kind: str = ""


@decides_about(ObserveStation, expect_station)
def observe_station(state: LabState, command: ObserveStation, station: StationState) -> Decision:
    wrong = refuse_hotel(state, command.station) or _refuse_sight(state, station, command)
    if wrong:
        return wrong
    events: list[Event] = [
        StationObserved(command.station, command.by, command.count, command.labware, command.kind)
    ]
    sight = Sight(state, command.by)
    if command.labware:
        labware = state.bench.labware[command.labware]
        if labware.station == command.station:
            return events  # as recorded
        if labware.station or not sight.count_room(command.station):
            return chain(events, _report_elsewhere(state, labware, station, command.by))
        sight.add_standing(labware.id, command.station)
        return chain(events, sight.events())
    return chain(events, _decide_count(state, sight, station, command))


def _refuse_sight(state: LabState, station: StationState, command: ObserveStation) -> Rejection | None:
    name = local(command.station)
    if station.spec.kind == "waste":
        return Rejection("waste", f"Labware in the waste {name} is off the bench and cannot be observed.")
    if command.count is not None and command.count < 0:
        return Rejection("bad_count", f"{command.count} pieces cannot stand at {name}.")
    labware = expect_labware(state, command) if command.labware else None
    if isinstance(labware, Rejection):
        return labware
    for action in state.actions.open.values():
        if action.status == ActionStatus.UNKNOWN:
            continue
        motions = list_carried(action.effects)
        hand = name_hand(action.module) if motions else ""
        moving = labware is not None and labware.moving == action.id
        if moving or command.station == hand or command.station in list_places(motions):
            return Rejection(
                "in_motion",
                f"{local(action.module)} is moving labware there, so an observation now would soon be "
                "out of date.",
                "Observe again when it has ended.",
            )
    worked_on = [name for name in station.labware if state.bench.labware[name].moving]
    if command.count == 0 and any(not _has_unknown_end(state, name) for name in worked_on):
        return Rejection("in_use", f"{', '.join(worked_on)} is being worked on at {name}.")
    if station.stock and command.count is not None and command.count < len(station.stock):
        return Rejection(
            "stock_differs",
            f"{name} is recorded with {len(station.stock)} pieces without ids, not {command.count}.",
            "Fill the stack and report that (`labos place`), or take the module out of service.",
        )
    return None


def _has_unknown_end(state: LabState, labware: LabwareId) -> bool:
    action = state.actions.open.get(ActionId(state.bench.labware[labware].moving))
    return action is not None and action.status == ActionStatus.UNKNOWN


class Sight:
    """The possible places of uncertain labware that remain after an observation. The state is not changed;
    ``events`` lists the events that follow."""

    def __init__(self, state: LabState, by: str) -> None:
        self._state, self._by = state, by
        self._left = {item.id: list(item.maybe) for item in state.bench.labware.values() if item.maybe}
        self._before = {name: tuple(left) for name, left in self._left.items()}
        self._found: dict[LabwareId, StationName] = {}
        self._standing: set[LabwareId] = set()

    def may_be_at(self, place: StationName, type_: str = "") -> list[LabwareId]:
        """Uncertain labware of the type that may stand there."""
        known = self._state.bench.labware
        return [n for n, left in self._left.items() if place in left and type_ in ("", known[n].type)]

    def count_room(self, place: StationName) -> int:
        """How many more pieces can stand at a place, besides those known there before or found now."""
        station = self._state.bench.stations.get(place)
        if station is None:
            return 0
        if station.spec.kind == "waste":
            return 1
        found = sum(where == place for where in self._found.values())
        return station.spec.capacity - len(station.labware) - len(station.stock) - found

    def add_standing(self, labware: LabwareId, place: StationName) -> None:
        """Note that the labware was seen at the place."""
        self._left[labware] = [place]
        self._standing.add(labware)
        self._conclude()

    def add_empty(self, place: StationName) -> None:
        """Note that nothing stands at the place."""
        for name in self.may_be_at(place):
            self._left[name] = [other for other in self._left[name] if other != place] or [GONE]
        self._conclude()

    def _conclude(self) -> None:
        """Labware with one possible place left is there. If it fills this place, the place is impossible for
        other labware. At a place with an observer, labware is there only when it was seen there."""
        for name, left in self._left.items():
            place = left[0]
            if name in self._found or len(left) > 1 or place == GONE or not self.count_room(place):
                continue
            station = self._state.bench.stations[place]
            if station.spec.watched and name not in self._standing:
                continue
            self._found[name] = place
            if not self.count_room(place):
                for other in self.may_be_at(place):
                    if other not in self._found:
                        kept = [p for p in self._left[other] if p != place]
                        self._left[other] = kept or [GONE]
            self._conclude()
            return

    def events(self) -> Iterator[Event]:
        """The events that place labware, and that withdraw questions which the observation has answered."""
        placed: set[LabwareId] = set()
        for question in list(self._state.interventions.open.values()):
            yield from self._answer(question, placed)
        for name, place in self._found.items():
            if name not in placed:
                yield self._make_event(name, place)
        for name, left in self._left.items():
            if name not in self._found and tuple(left) != self._before[name]:
                why = f"observed by {self._by}: it is not elsewhere"
                yield LabwareUncertain(name, "", tuple(left), why)

    def _make_event(self, name: LabwareId, place: StationName) -> Event:
        if self._state.bench.stations[place].spec.kind == "waste":
            return LabwareRemoved(name, "", place, "discarded")
        return LabwareObserved(name, "", place, self._by)

    def _answer(self, question: Intervention, placed: set[LabwareId]) -> Iterator[Event]:
        """The events for a question about labware that was found. ``placed`` is labware that other events of
        this observation place."""
        withdrawn = question.withdraw(f"observed by {self._by} at its place")
        topic = question.topic
        if isinstance(topic, UnknownAction):
            action = self._state.actions.open.get(ActionId(question.subject))
            choice = self._find_outcome(action, placed) if action is not None else ""
            if action is not None and choice:
                yield withdrawn
                yield from settle(self._state, action, choice, self._by)
            return
        names = {e.labware for e in list_moved(question.motions)} | set(question.labware)
        nameless = any(e.stock for e in list_carried(question.motions))
        if not isinstance(topic, LabwareInDoubt) or nameless:
            return
        known = self._state.bench.labware
        doubtful = [n for n in names if n in known and known[n].maybe and self._in_doubt(n)]
        if doubtful or not names & self._found.keys():
            return
        yield withdrawn
        if isinstance(topic, LostLabware):
            yield from self._ask_about_left_labware(topic)

    def _ask_about_left_labware(self, topic: LostLabware) -> Iterator[Event]:
        """A person is asked about labware that an ended run left in the way."""
        stations = self._state.bench.stations
        left = {n: p for n, p in self._found.items() if not stations[p].spec.is_storage}
        mine = {e.labware for e in list_moved(topic.motions)}
        left = {name: place for name, place in left.items() if name in mine}
        if not left or self._state.runs.get(topic.run) is not None:
            return
        whose = f"Labware that run {topic.run} lost" if topic.run else "Lost labware"
        for some in split_into_batches(LeftLabware, list(left)):
            stands = name_some([f"{name} at {local(left[name])}" for name in some])
            found = LeftLabware(module=topic.module, labware=tuple(some), lost_by=topic.action)
            yield self._state.interventions.ask(found, f"{whose} was seen by {self._by}: {stands}.")

    def _in_doubt(self, name: LabwareId) -> bool:
        """Whether labware was found in a hand: a person still has to put it down and report the place."""
        place = self._found.get(name)
        return place is None or self._state.bench.stations[place].spec.kind == "gripper"

    def _find_outcome(self, action: Action, placed: set[LabwareId]) -> str:
        """The outcome of an unknown action, if the place of its labware shows it; otherwise empty."""
        names = [e.labware for e in list_moved(action.effects)]
        choice = find_shown_outcome(self._state, action, self._found.get(names[0])) if names else ""
        if choice:
            placed.add(names[0])
        return choice


def _decide_count(
    state: LabState, sight: Sight, station: StationState, command: ObserveStation
) -> Iterable[Event]:
    name = command.station
    here = [state.bench.labware[item] for item in station.labware]
    known = len(here) + len(station.stock)
    types = {item.type for item in here} | set(station.stock)
    if command.kind and known and command.kind not in types and not sight.count_room(name):
        return _doubt_recorded(state, here, station, command, command.kind)
    fits = known and (not command.kind or command.kind in types)
    more = command.count - known if command.count is not None else (0 if fits else 1)
    if more < 0:
        return _doubt_recorded(state, here, station, command)
    if more == 0:
        sight.add_empty(name)
        return chain(_withdraw_strange(state, name), sight.events())
    if any(name in found for found in state.bench.searched.values()):
        return []  # it may be an item from a stack that has no id yet
    may_be = sight.may_be_at(name, command.kind)
    if len(may_be) < more:
        taken = _find_take(state, name)
        if taken is not None:
            return _settle_take(state, taken, name, command.by)
        return _report_unexpected(state, station, command)
    if len(may_be) == more:
        for item in may_be:
            sight.add_standing(item, name)
    return sight.events()


def _find_take(state: LabState, place: StationName) -> Action | None:
    """The action with an unknown outcome that may have brought an item from a stack to a place; None if there
    is none."""
    for action in state.actions.open.values():
        takes = [e for e in list_carried(action.effects) if e.stock]
        hand = name_hand(action.module)
        if action.status == ActionStatus.UNKNOWN and any(place in (hand, e.source, e.target) for e in takes):
            return action
    return None


def _settle_take(state: LabState, action: Action, place: StationName, by: str) -> Iterable[Event]:
    """The item from a stack was seen: if it is at its target, the action was done."""
    motions = list_carried(action.effects)
    question = state.interventions.find_about(action.id)
    there = len(motions) == 1 and motions[0].target == place
    if question is None or not there or is_read_later(state, action) or may_still_act(state, action):
        return []
    withdrawn = question.withdraw(f"observed by {by} at its place")
    return chain([withdrawn], settle(state, action, "done", by))


def _withdraw_strange(state: LabState, place: StationName) -> list[Event]:
    """The unexpected labware has left the place: withdraw the question about it."""
    question = state.interventions.find_about(place, Contradiction)
    if question is None or question.labware:
        return []
    return [question.withdraw("observed to be no longer there")]


def _doubt_recorded(
    state: LabState, here: list[Labware], station: StationState, command: ObserveStation, other_type: str = ""
) -> Iterator[Event]:
    """The recorded labware was not seen, or labware of another type. If no labware with an id stands there,
    nothing follows: a person has declared the stock of a stack."""
    place = station.spec.name
    for item in here:
        yield LabwareUncertain(item.id, "", (place, GONE), f"not seen by {command.by}")
    for some in split_into_batches(NotSeen, here):
        names = tuple(item.id for item in some)
        if other_type:
            recorded = name_some([f"{item.id} ({item.type})" for item in some])
            text = f"{command.by} saw {other_type} at {local(place)}, where {recorded} should stand."
        else:
            seen = "empty" if not command.count else f"with {command.count}"
            text = (
                f"{command.by} saw {local(place)} {seen}, where {name_some(names)} should stand. Where is it?"
                f" If it stands elsewhere, say so with `labos observe STATION {names[0]}`."
            )
        topic = NotSeen(module=station.spec.module, station=place, labware=names, other_type=other_type)
        yield state.interventions.ask(topic, text)


def _report_elsewhere(state: LabState, labware: Labware, station: StationState, by: str) -> Iterator[Event]:
    """Labware was recognised at an unexpected station, or at one where other labware is recorded. One
    question is about this labware and the labware that it may have replaced. If that is too much for one
    question, further ones are about the rest."""
    place = station.spec.name
    recorded = labware.station
    others = list(station.labware) if station.spec.capacity <= len(station.labware) else []
    may_be = tuple(dict.fromkeys((place, *((recorded,) if recorded else labware.maybe))))
    known = f"recorded at {local(recorded)}" if recorded else "with unknown place"
    holds = f", where {name_some(others)} should stand" if others else ""
    yield LabwareUncertain(labware.id, "", may_be, f"seen at {local(place)} by {by}")
    for item in others:
        yield LabwareUncertain(item, "", (place, GONE), f"{labware.id} was observed at its place")
    first, *rest = list(split_into_batches(NotSeen, others)) or [()]
    topic = SeenElsewhere(
        module=station.spec.module,
        station=place,
        labware=labware.id,
        recorded=recorded,
        others=tuple(first),
    )
    yield state.interventions.ask(topic, f"{by} saw {labware.id}, {known}, at {local(place)}{holds}.")
    for some in rest:
        yield state.interventions.ask(
            NotSeen(module=station.spec.module, station=place, labware=tuple(some)),
            f"{by} saw {labware.id} at {local(place)}, where {name_some(some)} should stand.",
        )


def _report_unexpected(state: LabState, station: StationState, command: ObserveStation) -> list[Event]:
    """Labware stands at a place that is empty in the log. Until this is settled, no other labware is put
    there."""
    place = station.spec.name
    if state.interventions.find_about(place, Contradiction) is not None:
        return []
    kind = command.kind or (station.spec.accepts[0] if len(station.spec.accepts) == 1 else "")
    named = "" if station.spec.kind == "gripper" else kind
    return [
        state.interventions.ask(
            Unexpected(module=station.spec.module, station=place, type=named),
            f"{command.by} saw {kind or 'something'} at {local(place)}, where nothing should stand.",
        )
    ]


def settle_sight(
    state: LabState, topic: NotSeen | SeenElsewhere | Unexpected, choice: str, by: str
) -> list[Event]:
    """The events that follow when a person reports what stands at a station. Labware that was found meanwhile
    is not changed."""
    here = topic.station
    match topic:
        case NotSeen():
            where = dict.fromkeys(topic.labware, here if choice == "there" else GONE)
        case SeenElsewhere():
            place = {"seen": here, "recorded": topic.recorded}.get(choice, GONE)
            where = {topic.labware: place, **dict.fromkeys(topic.others, GONE if choice == "seen" else here)}
        case Unexpected():
            new = choice == "new"
            return [LabwarePlaced(state.bench.next_id, "", topic.type, here, SHARED)] if new else []
        case _:
            assert_never(topic)
    return [_observe_at(name, place, by) for name, place in where.items() if find_uncertain(state, name)]


def _observe_at(labware: LabwareId, place: StationName, by: str) -> Event:
    if place == GONE:
        return LabwareRemoved(labware, "", GONE, f"not where it was recorded ({by})")
    return LabwareObserved(labware, "", place, by)
