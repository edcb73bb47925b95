"""What is legal here and now: the rules that planning proposes by and ``decide`` enforces.

``examine`` answers for one step of one run: its effects with the labware written in, or the
first thing it waits for. Whether a start could trap the lab is not decided here but in planning.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import msgspec

from labos.core.actions import Action
from labos.core.bench import Labware, Station, a1_after, arrivals, hand_of, parts, taking, variable_of
from labos.core.effects import (
    AnyEffect,
    Claims,
    Consumes,
    Move,
    Needs,
    Reads,
    Relid,
    Requires,
    Sets,
    Take,
    Transfers,
    Unlid,
)
from labos.core.ids import (
    SHARED,
    LabwareId,
    ModuleName,
    Owner,
    RunId,
    StationName,
    experiment_owner,
    run_owner,
    user_owner,
    workcell_of,
)
from labos.core.model import PlanStep
from labos.core.resources import needed
from labos.core.runs import DONE, PENDING, RunState, anchored_at
from labos.core.state import LabState
from labos.core.zones import at_work_in, stopped_in, zones_of


class Wait(msgspec.Struct, frozen=True):
    """Why a step cannot start. ``code`` and ``names`` make the sentence; ``on`` are the keys
    whose change may end the wait; ``until`` is a time (UTC ns) that ends it by itself.

    ``blocked`` waits need a person or a device to come back; the others pass by themselves.
    """

    code: str
    names: tuple[str, ...] = ()
    on: tuple[str, ...] = ()
    until: int | None = None
    blocked: bool = False


def module_key(module: ModuleName) -> str:
    return f"module:{module}"


def station_key(station: StationName) -> str:
    return f"station:{station}"


def zone_key(zone: str) -> str:
    return f"zone:{zone}"


def access_key(cell: str) -> str:
    return f"access:{cell}"


def run_key(run: RunId) -> str:
    return f"run:{run}"


def party(run: RunState) -> tuple[Owner, ...]:
    """The owners whose labware a run may use, nearest first."""
    owners = [run_owner(run.id)]
    if run.experiment:
        owners.append(experiment_owner(run.experiment))
    return (*owners, user_owner(run.user), SHARED)


def examine(state: LabState, run: RunState, index: int, now: int) -> Wait | tuple[AnyEffect, ...]:
    """The bound effects with which the step may start now, or what it waits for."""
    step = state.runs.plan_of(run).steps[index]
    return (
        _own_turn(run, step, index)
        or no_hands_inside(state, run, step)
        or _in_window(state, run, step, now)
        or _rested(state, run, step, index, now)
        or module_free(state, run, step)
        or zones_free(state, step)
        or _supplied(state, run)
        or bind(state, run, step)
    )


def _own_turn(run: RunState, step: PlanStep, index: int) -> Wait | None:
    if run.paused:
        return Wait("paused", (run.id,), (run_key(run.id),), blocked=True)
    if run.status == "cancelling":
        return Wait("cancelling", (run.id,), (run_key(run.id),))
    if not run.steps:  # not started yet
        return None if not step.after else Wait("after", (), (run_key(run.id),))
    if run.steps[index] != PENDING:
        return Wait("not_pending", (step.key,), (run_key(run.id),))
    for before in step.after:
        if run.steps[before] != DONE:
            return Wait("after", (str(before),), (run_key(run.id),))
    return None


def no_hands_inside(state: LabState, run: RunState, step: PlanStep) -> Wait | None:
    """Nothing starts in a workcell into which a person reaches; arms are parked before."""
    cell = workcell_of(step.module)
    access = state.lab.access.get(cell)
    if access is None or (not access.granted and run.plan in access.parking):
        return None
    return Wait("access", (cell, access.by), (access_key(cell),), blocked=True)


def _in_window(state: LabState, run: RunState, step: PlanStep, now: int) -> Wait | None:
    for window in step.windows:
        ended = anchored_at(run, window)
        if ended is None:
            continue
        earliest = ended + lab_ns(state, window.wait_s)
        if now < earliest:
            return Wait("too_early", (step.key,), (), until=earliest)
    return None


def _rested(state: LabState, run: RunState, step: PlanStep, index: int, now: int) -> Wait | None:
    """Whether a step that failed has waited long enough to be tried again."""
    failed_at = run.retried_at.get(str(index))
    if failed_at is None or step.retry is None:
        return None
    again = failed_at + lab_ns(state, step.retry.delay_s)
    return Wait("retry_later", (step.key,), (), until=again) if now < again else None


def due_at(state: LabState, action: Action) -> int | None:
    """When an action has to have ended (UTC ns); None if its step sets no time, it is known already
    that nobody knows, or a person does it: who is late is asked again, and knows."""
    run = state.runs.active.get(action.run)
    if run is None or action.status == "unknown":
        return None
    step = state.runs.plan_of(run).steps[action.step]
    if step.timeout_s is None or step.by_person:
        return None
    return action.requested_at + lab_ns(state, step.timeout_s)


def lab_ns(state: LabState, seconds: float) -> int:
    """Lab seconds as nanoseconds of wall time."""
    return int(seconds * 1e9 / state.lab.pace)


def module_free(state: LabState, run: RunState, step: PlanStep) -> Wait | None:
    """Whether the step's module may be used by this run now."""
    module = state.modules.by_name.get(step.module)
    key = module_key(step.module)
    if module is None:
        return Wait("no_module", (step.module,), (key,), blocked=True)
    if module.out_of_service:
        return Wait("out_of_service", (step.module, module.out_of_service), (key,), blocked=True)
    if module.status == "GONE" or (module.status == "ERROR" and not step.recovers):
        return Wait("module_down", (step.module, module.status, module.error), (key,), blocked=True)
    if not step.exclusive:
        return None
    # A device that does not come to rest by itself may need this very recovery.
    if module.busy or (module.status == "BUSY" and not step.recovers):
        return Wait("module_busy", (step.module,), (key,))
    # Whoever holds a module in error cannot go on before it is well again.
    holder = "" if step.recovers else held_by_other(state, step.module, run)
    if holder:
        return Wait("held", (step.module, holder), (key,))
    for name in state.bench.by_module.get(step.module, ()):
        station = state.bench.stations[name]
        if not station.spec.is_storage and (station.expected or _in_motion(state, station)):
            return Wait("reached_into", (name,), _until_left_alone(state, name))
    return None


def zones_free(state: LabState, step: PlanStep) -> Wait | None:
    """Whether no other arm is where this step's arm would go."""
    for zone in zones_of(state, step.module, step.effects) if step.exclusive else ():
        busy = at_work_in(state, zone, step.module)
        if busy:
            return Wait("zone_busy", (busy, zone), (zone_key(zone), module_key(busy)))
        stopped = "" if step.recovers else stopped_in(state, zone, step.module)
        if stopped:
            keys = (zone_key(zone), module_key(ModuleName(stopped)))
            return Wait("zone_barred", (stopped, zone), keys, blocked=True)
    return None


def _until_left_alone(state: LabState, place: StationName) -> tuple[str, ...]:
    """The keys of a station and of the modules at work there: an arm that only changed its grip
    there, or a module that worked on what stands there, leaves no other trace."""
    bench = state.bench
    standing = {bench.labware[name].moving for name in bench.stations[place].labware}
    modules = [
        action.module
        for action in state.actions.open.values()
        if action.id in standing or place in arrivals(action.effects)
    ]
    return (station_key(place), *(module_key(module) for module in modules))


def _in_motion(state: LabState, station: Station) -> bool:
    labware = state.bench.labware
    return any(labware[name].moving for name in station.labware)


def held_by_other(state: LabState, name: ModuleName, run: RunState) -> str:
    """The owner who holds a module against this run: whose labware stands where it claims the
    module, whose plan says so, or who left a door or lid away from rest. Empty if nobody does."""
    return (
        claimed_by_other(state, name, party(run))
        or holder_by_plan(state, name, run)
        or door_left_by(state, name, run)
    )


def claimed_by_other(state: LabState, name: ModuleName, allowed: tuple[Owner, ...]) -> str:
    """Whose labware stands where it claims the module, is about to, or may be standing there; not one
    of the allowed."""
    bench = state.bench
    for station in bench.by_module.get(name, ()):
        place = bench.stations[station]
        if place.spec.claim:
            for labware in place.labware:
                owner = bench.labware[labware].owner
                if owner not in allowed:
                    return owner or "nobody"
            for lost in bench.labware.values() if station in bench.haunted else ():
                if station in lost.maybe and lost.owner not in allowed:
                    return lost.owner or "nobody"
            for action in state.actions.open.values() if place.expected else ():
                if station in arrivals(action.effects) and run_owner(action.run) not in allowed:
                    return run_owner(action.run)
    return ""


def holder_by_plan(state: LabState, name: ModuleName, run: RunState) -> str:
    """Which other run keeps the module by its plan's word."""
    return next((run_owner(holder) for holder in state.runs.holding(name) if holder != run.id), "")


def door_left_by(state: LabState, name: ModuleName, run: RunState) -> str:
    """Which other run left a door or lid of the module away from rest."""
    module = state.modules.by_name[name]
    for variable, value in module.spec.rest.items():
        by = module.set_by.get(variable, "")
        if module.variables.get(variable) != value and by != run.id and by in state.runs.active:
            return run_owner(RunId(by))
    return ""


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
            case Reads() | Transfers():
                labware = subject.id if subject else labware
            case Consumes():
                wait = _enough(state, step, effect)
                if wait:
                    return wait
        if labware and not isinstance(effect, Take | Consumes):
            effect = msgspec.structs.replace(effect, labware=labware)
        bound.append(effect)
    return _room_for_all(state, bound) or tuple(bound)


def _supplied(state: LabState, run: RunState) -> Wait | None:
    """A run is let in only where as much is left as all its steps use up, or as the module can
    hold at the most: what runs dry half-way would stand in others' way until somebody comes."""
    if run.steps:
        return None
    total: dict[tuple[ModuleName, str], float] = {}
    for _, module, resource, amount in state.runs.plans[run.plan].uses_up:
        total[module, resource] = total.get((module, resource), 0.0) + amount
    for (module, resource), amount in total.items():
        level = state.resources.of(module, resource)
        if level is None:
            continue
        left = unpromised(state, module, resource)
        if left is not None and left < min(amount, level.capacity):
            return Wait("used_up", (module, resource), (module_key(module),), blocked=True)
    return None


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
        if number > 1 and station.count + number > station.spec.capacity:
            names = (place, f"{number} arrivals at once")
            return Wait("occupied", names, _until_left_alone(state, place))
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
        return Wait("hand_full", (step.module, _occupants(state, station)), _until_left_alone(state, hand))
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
    return (
        hand_free(state, step, effect.stack)
        or reachable(state, run, effect.target)
        or room_at(state, run, effect.target, parts(stack.stock[left - 1])[0])
    )


def _bind_needs(state: LabState, run: RunState, step: PlanStep, effect: Needs) -> Wait | Labware:
    places = [effect.station] if effect.station else state.bench.by_module.get(step.module, [])
    for place in places:
        labware = usable_at(state, run, place)
        if labware is not None:
            return labware
    return nothing_at(state, run, places[0] if places else StationName(step.module))


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
    if place in state.bench.haunted:
        return Wait("uncertain", (place,), key, blocked=True)
    if station is not None and station.labware:
        labware = state.bench.labware[station.labware[-1]]
        if labware.moving:
            return Wait("in_motion", (labware.id, place), _until_left_alone(state, place))
        return Wait("not_yours", (labware.id, place, labware.owner or "nobody"), key, blocked=True)
    if station is not None and not station.known and not station.expected:
        return Wait("undeclared", (place,), key, blocked=True)
    return Wait("nothing_there", (place,), key, blocked=not _on_its_way(state, run))


def _on_its_way(state: LabState, run: RunState) -> bool:
    """Whether labware of this run is being carried, and may yet arrive."""
    return any(item.moving for item in state.bench.owned(run_owner(run.id)))


def reachable(state: LabState, run: RunState, place: StationName) -> Wait | None:
    """Whether a manipulator may reach into a station: its module idle, open, not another's."""
    spec = state.bench.stations[place].spec
    if not spec.module or spec.is_storage:
        return None
    module = state.modules.by_name[spec.module]
    key = (module_key(spec.module),)
    if module.busy:
        return Wait("module_busy", (spec.module,), key)
    shut = door_open(state, place)
    if shut:
        return shut
    holder = held_by_other(state, spec.module, run) if spec.claim else ""
    if holder:
        return Wait("held", (spec.module, holder), key)
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
    if station.spec.accepts and labware_type not in station.spec.accepts:
        return Wait("not_accepted", (place, labware_type), key, blocked=True)
    if place in state.bench.haunted:
        return Wait("uncertain", (place,), key, blocked=True)
    if not station.known and not station.labware and station.spec.kind != "waste":
        return Wait("undeclared", (place,), key, blocked=True)
    if station.full:
        if station.spec.kind == "waste":
            return Wait("waste_full", (place,), key, blocked=True)
        return Wait("occupied", (place, _occupants(state, station)), _until_left_alone(state, place))
    return None


def _occupants(state: LabState, station: Station) -> str:
    return ", ".join(station.labware) or ("an arrival under way" if station.expected else "stock")
