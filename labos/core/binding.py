"""Which labware the effects of a step touch, and whether all of them are possible here and now."""

from __future__ import annotations

from collections import Counter
from typing import Any

import msgspec

from labos.core.bench import Labware, a1_after, parts, taking, variable_of
from labos.core.effects import (
    AnyEffect,
    Claims,
    Consumes,
    Draws,
    Move,
    Needs,
    Reads,
    Relid,
    Requires,
    Sets,
    Take,
    Transfers,
    Unlid,
    arrivals,
    hand_of,
)
from labos.core.holding import held_by_other
from labos.core.ids import LabwareId, ModuleName, RunId, StationName, run_owner
from labos.core.model import PlanStep
from labos.core.modules import Module
from labos.core.resources import needed
from labos.core.runs import RunState
from labos.core.shelves import in_doubt, on_shelves, ready, taken
from labos.core.state import LabState
from labos.core.waits import Wait, module_key, occupants, party, station_key, until_left_alone


def bind(state: LabState, run: RunState, step: PlanStep) -> Wait | tuple[AnyEffect, ...]:
    """Write into the effects which labware they touch, if all of them are possible now."""
    bound: list[AnyEffect] = []
    subject: Labware | None = None
    for effect in step.effects:
        labware = LabwareId("")
        match effect:
            case Unlid() | Relid():
                lid = _bind_lid(state, run, step, effect)
                if isinstance(lid, Wait):
                    return lid
                effect, subject, labware = lid, state.bench.labware[lid.plate], lid.labware
                if any(isinstance(other, Move) and other.labware == labware for other in bound):
                    return Wait("nothing_there", (effect.source,), (station_key(effect.source),))
            case Move():
                found = _bind_move(state, run, step, effect)
                if isinstance(found, Wait):
                    return found
                subject, labware = found, found.id
                if any(isinstance(other, Move) and other.labware == labware for other in bound):
                    return Wait("nothing_there", (effect.source,), (station_key(effect.source),))
            case Take():
                wait = _may_take(state, run, step, effect)
                if wait:
                    return wait
            case Needs():
                found = _bind_needs(state, run, step, effect)
                if isinstance(found, Wait):
                    return found
                subject, labware = found, found.id
            case Requires():
                wait = _holds(state, step, effect, subject)
                if wait:
                    return wait
                labware = subject.id if effect.of == "labware" and subject else labware
            case Sets():
                labware = subject.id if effect.of == "labware" and subject else labware
            case Claims():
                wait = _setpoint_free(state, run, step, effect)
                if wait:
                    return wait
            case Reads() | Transfers() | Draws():
                labware = subject.id if subject else labware
            case Consumes():
                wait = _enough(state, step, effect)
                if wait:
                    return wait
        if labware and not isinstance(effect, Take | Consumes):
            effect = msgspec.structs.replace(effect, labware=labware)
        if state.bench.shelves:
            effect = on_shelves(state.bench, effect, arrivals(tuple(bound)))
        bound.append(effect)
    return (_room_for_all(state, bound) if bound else None) or tuple(bound)


def _enough(state: LabState, step: PlanStep, effect: Consumes) -> Wait | None:
    """As much is left as the whole step needs, beside what actions in flight were promised."""
    left = unpromised(state, step.module, effect.resource)
    if left is None or left >= needed(step.effects, effect.resource):
        return None
    return Wait("used_up", (step.module, effect.resource), (module_key(step.module),), blocked=True)


def unpromised(state: LabState, module: ModuleName, resource: str) -> float | None:
    """What is left of a resource when everything in flight has used what it needs; None if
    nobody ever said how much there is."""
    left = state.resources.left(module, resource)
    if left is None:
        return None
    flying = map(state.actions.open.__getitem__, state.modules.by_name[module].in_flight)
    return left - sum(needed(action.effects, resource) for action in flying)


def _setpoint_free(state: LabState, run: RunState, step: PlanStep, effect: Claims) -> Wait | None:
    """Nobody else needs the module to be set to another value."""
    module = state.modules.by_name[step.module]
    wanted: dict[str, Any] = {}
    held = module.setpoints.get(effect.setpoint)
    if held is not None:
        wanted.update(dict.fromkeys(held.holders, held.value))
    for action in map(state.actions.open.__getitem__, module.in_flight):
        for other in action.effects:
            if isinstance(other, Claims) and other.setpoint == effect.setpoint:
                wanted[action.run] = other.value
    for holder, value in wanted.items():
        if holder != run.id and (value is None or value != effect.value):
            names = (step.module, effect.setpoint, str(value), run_owner(RunId(holder)))
            return Wait("setpoint", names, (module_key(step.module),))
    return None


def _room_for_all(state: LabState, bound: list[AnyEffect]) -> Wait | None:
    """What there is room for one by one has to find room together."""
    for place, number in Counter(arrivals(tuple(bound))).items():
        station = state.bench.stations[place]
        together = number > 1 and station.count + number > station.spec.capacity
        if together or place in state.bench.shelves:  # for this one no shelf was left
            names = (place, f"{number} arrivals at once")
            return Wait("occupied", names, until_left_alone(state, place))
    for stack, number in Counter(e.stack for e in bound if isinstance(e, Take)).items():
        if number > len(state.bench.stations[stack].stock) - taking(state.bench, stack):
            return Wait("stack_empty", (stack,), (station_key(stack),), blocked=True)
    return None


def _bind_move(state: LabState, run: RunState, step: PlanStep, effect: Move) -> Wait | Labware:
    labware = usable_at(state, run, effect.source)
    if labware is None:
        return nothing_at(state, run, effect.source)
    wait = hand_free(state, step, effect.source) or gripped(state, step, effect, labware.type)
    if wait:
        return wait
    return (
        reachable(state, run, effect.source)
        or reachable(state, run, effect.target)
        or room_at(state, run, effect.target, labware.type)
        or (room_at(state, run, effect.via, labware.type) if effect.via else None)
        or facing(state, effect, labware)
        or labware
    )


def _bind_lid(state: LabState, run: RunState, step: PlanStep, effect: Unlid | Relid) -> Wait | Unlid | Relid:
    """The lid that comes off a plate or onto one: a plate has one lid at a time."""
    at = effect.source if isinstance(effect, Unlid) else effect.target
    plate = usable_at(state, run, at)
    if plate is None:
        return nothing_at(state, run, at)
    if isinstance(effect, Unlid):
        lid = state.bench.labware[plate.lid] if plate.lid else None
    else:
        lid = usable_at(state, run, effect.source)
        if lid is None:
            return nothing_at(state, run, effect.source)
    if lid is None or (isinstance(effect, Relid) and plate.lid):
        wanted = str(isinstance(effect, Unlid))
        return Wait("requires", (plate.id, "lidded", wanted), (station_key(at),))
    wait = (
        hand_free(state, step, effect.source)
        or gripped(state, step, effect, lid.type)
        or reachable(state, run, effect.source)
        or reachable(state, run, effect.target)
        or (room_at(state, run, effect.target, lid.type) if isinstance(effect, Unlid) else None)
        or (room_at(state, run, effect.via, lid.type) if effect.via else None)
    )
    return wait or msgspec.structs.replace(effect, labware=lid.id, plate=plate.id)


def hand_free(state: LabState, step: PlanStep, source: StationName) -> Wait | None:
    """An arm that holds labware, or may still hold lost labware, carries nothing else: it only puts
    down what it holds."""
    hand = hand_of(step.module)
    if hand in state.bench.haunted:
        return Wait("uncertain", (hand,), (station_key(hand),), blocked=True)
    station = state.bench.stations.get(hand)
    if station is not None and station.count and source != hand:
        return Wait("hand_full", (step.module, occupants(state, station)), until_left_alone(state, hand))
    return None


def facing(state: LabState, effect: Move, labware: Labware) -> Wait | None:
    """Whether labware would come to lie as its target takes it: with A1 in the right corner."""
    wanted = state.bench.stations[effect.target].spec.a1
    way = a1_after(state.bench, effect, labware)
    if wanted is None or way == wanted:
        return None
    names = (labware.id, effect.target, str(way), str(wanted))
    return Wait("wrong_way", names, (station_key(effect.source),), blocked=True)


def gripped(state: LabState, step: PlanStep, effect: Move, labware_type: str) -> Wait | None:
    """Whether the arm can hold labware of the type as the step says, where it takes it and where
    it puts it down."""
    for place, grip in ((effect.source, effect.source_grip), (effect.target, effect.target_grip)):
        grips = state.bench.stations[place].spec.grips(step.module, labware_type)
        if grip and grips and grip not in grips:
            names = (step.module, place, labware_type, grip, " or ".join(grips))
            return Wait("no_grip", names, (station_key(effect.source),), blocked=True)
    return None


def _may_take(state: LabState, run: RunState, step: PlanStep, effect: Take) -> Wait | None:
    stack = state.bench.stations[effect.stack]
    key = (station_key(effect.stack),)
    if stack.labware:
        return Wait("buried", (effect.stack, stack.labware[-1]), key)
    if effect.stack in state.bench.haunted:
        return Wait("uncertain", (effect.stack,), key, blocked=True)
    left = len(stack.stock) - taking(state.bench, effect.stack)
    if left <= 0:
        return Wait("stack_empty", (effect.stack,), key, blocked=True)
    alike = {*zip(stack.stock[left - 1 :], stack.lots[left - 1 :], strict=True)}
    if stack.expected or len(alike) > 1:
        return Wait("reached_into", (effect.stack,), until_left_alone(state, effect.stack))
    return (
        hand_free(state, step, effect.stack)
        or reachable(state, run, effect.target)
        or room_at(state, run, effect.target, parts(stack.stock[left - 1])[0])
    )


def _bind_needs(state: LabState, run: RunState, step: PlanStep, effect: Needs) -> Wait | Labware:
    places = _where_needed(state, step, effect)
    return needed_by(state, run, step, effect) or nothing_at(
        state, run, places[0] if places else StationName(step.module)
    )


def needed_by(state: LabState, run: RunState, step: PlanStep, effect: Needs) -> Labware | None:
    """The labware that a step works on, if it stands there."""
    found = (usable_at(state, run, place) for place in _where_needed(state, step, effect))
    return next((labware for labware in found if labware is not None), None)


def _where_needed(state: LabState, step: PlanStep, effect: Needs) -> list[StationName]:
    return [effect.station] if effect.station else state.bench.by_module.get(step.module, [])


def _holds(state: LabState, step: PlanStep, effect: Requires, subject: Labware | None) -> Wait | None:
    if effect.of == "module":
        value = state.modules.by_name[step.module].variables.get(effect.variable)
        name, key = str(step.module), module_key(step.module)
    elif subject is not None:
        value = variable_of(subject, effect.variable)
        name, key = str(subject.id), station_key(subject.station)
    else:
        return None
    if same(value, effect.value):
        return None
    return Wait("requires", (name, effect.variable, str(effect.value)), (key,))


def same(actual: Any, wanted: Any) -> bool:
    """Whether a variable has the wanted value; one that was never set counts as false."""
    return bool((actual if actual is not None else False) == wanted)


def usable_at(state: LabState, run: RunState, place: StationName) -> Labware | None:
    """The labware at a station that this run may use and reach: its own before its experiment's,
    its user's and what is shared; on a stack only the topmost; no plate whose lid is lost."""
    station = state.bench.stations.get(place)
    if station is None:
        return None
    labware = state.bench.labware
    reach = station.labware[-1:] if station.spec.kind == "stack" else station.labware
    for owner in party(run):
        for name in reversed(reach):
            item = labware[name]
            if item.owner == owner and not item.moving and not state.bench.in_doubt(item):
                return item
    return None


def nothing_at(state: LabState, run: RunState, place: StationName) -> Wait:
    """Why there is nothing to use: uncertain, somebody else's, in motion, or simply empty."""
    station = state.bench.stations.get(place)
    key = (station_key(place),)
    if in_doubt(state.bench, place):
        return Wait("uncertain", (place,), key, blocked=True)
    if station is not None and station.labware:
        labware = state.bench.labware[station.labware[-1]]
        if labware.moving:
            return Wait("in_motion", (labware.id, place), until_left_alone(state, place))
        return Wait("not_yours", (labware.id, place, labware.owner or "nobody"), key, blocked=True)
    if station is not None and not station.known and not station.expected:
        return Wait("undeclared", (place,), key, blocked=True)
    return Wait("nothing_there", (place,), key, blocked=not _on_its_way(state, run))


def _on_its_way(state: LabState, run: RunState) -> bool:
    """Whether labware of this run is being carried, and may yet arrive."""
    return any(item.moving for item in state.bench.owned(run_owner(run.id)))


def reachable(state: LabState, run: RunState, place: StationName) -> Wait | None:
    """Whether a manipulator may reach into a station: its module idle, open, not another's; a stack only
    if no other hand is there."""
    spec = state.bench.stations[place].spec
    disturbed = undisturbed(state, place)
    if disturbed or not spec.module or spec.stands_apart:
        return disturbed
    module = state.modules.by_name[spec.module]
    key = (module_key(spec.module),)
    if module.busy or module.status == "BUSY":
        return Wait("module_busy", (spec.module,), key)
    if module.cut_off:
        return laid_up(module)
    shut = door_open(state, place)
    if shut:  # nobody opens it before somebody has looked after a module that is down
        return laid_up(module) or shut
    holder = held_by_other(state, spec.module, run) if spec.claim else ""
    if holder:
        return Wait("held", (spec.module, holder), key)
    return None


def laid_up(module: Module, *, recovers: bool = False) -> Wait | None:
    """Whether somebody has to look after a module first; what ``recovers`` it from an error need not wait."""
    name, key = module.spec.name, (module_key(module.spec.name),)
    if module.out_of_service:
        return Wait("out_of_service", (name, module.out_of_service), key, blocked=True)
    if module.status == "GONE" or (module.status == "ERROR" and not recovers):
        return Wait("module_down", (name, module.status, module.error), key, blocked=True)
    return None


def undisturbed(state: LabState, place: StationName) -> Wait | None:
    """One hand at a time at a stack of plates with names: of two, nobody could say whose plate came to
    lie on top. Nameless items of one kind may be taken by several."""
    station = state.bench.stations[place]
    if station.spec.kind != "stack" or place in state.bench.haunted:  # of which it is asked elsewhere
        return None
    moving = any(state.bench.labware[name].moving for name in station.labware)
    if station.expected or moving or taking(state.bench, place):
        return Wait("reached_into", (place,), until_left_alone(state, place))
    return None


def door_open(state: LabState, place: StationName) -> Wait | None:
    """Whether the doors and lids in front of a station are out of the way."""
    spec = state.bench.stations[place].spec
    for variable, value in spec.access.items():
        if not same(state.modules.by_name[spec.module].variables.get(variable), value):
            return Wait("no_access", (place, variable, str(value)), (module_key(spec.module),))
    return None


def room_at(state: LabState, run: RunState, place: StationName, labware_type: str) -> Wait | None:
    """Whether a station can take one more of this type."""
    station = state.bench.stations[place]
    key = (station_key(place),)
    if not station.spec.admits(labware_type):
        return Wait("not_accepted", (place, labware_type), key, blocked=True)
    if place in state.bench.shelves:
        return _room_on_shelves(state, place)
    if place in state.bench.haunted:
        return Wait("uncertain", (place,), key, blocked=True)
    if not station.known and not station.labware and station.spec.kind != "waste":
        return Wait("undeclared", (place,), key, blocked=True)
    if station.full:
        if station.spec.kind == "waste":
            return Wait("waste_full", (place,), key, blocked=True)
        return Wait("occupied", (place, occupants(state, station)), until_left_alone(state, place))
    return None


def _room_on_shelves(state: LabState, hotel: StationName) -> Wait | None:
    """Whether a shelf of a hotel is free."""
    bench = state.bench
    if ready(bench, hotel) is not None:
        return None
    if taken(bench, hotel):
        names = (hotel, occupants(state, bench.stations[hotel]))
        return Wait("occupied", names, until_left_alone(state, hotel))
    why = "uncertain" if in_doubt(bench, hotel) else "undeclared"
    return Wait(why, (hotel,), (station_key(hotel),), blocked=True)
