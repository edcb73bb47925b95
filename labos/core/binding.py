"""Which labware the effects of a step touch, and whether all of them are possible here and now."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from typing import Any

import msgspec

from labos.core import reasons
from labos.core.algebra import check_effect, compute_settings_after
from labos.core.bench import Labware, compute_a1_after, count_taking, find_variable, split_item
from labos.core.effects import (
    AnyEffect,
    Carrying,
    Claims,
    Consumes,
    Draws,
    Effect,
    Move,
    Needs,
    Reads,
    Relid,
    Requires,
    Sets,
    Transfers,
    Unlid,
    list_arrivals,
    list_carried,
    name_hand,
)
from labos.core.holding import find_other_holder, find_other_keeper
from labos.core.ids import LabwareId, ModuleName, RunId, StationName, module_key, run_owner, station_key
from labos.core.model import PlanStep
from labos.core.modules import Module, ModuleStatus
from labos.core.resources import sum_needed
from labos.core.runs import RunState
from labos.core.shelves import find_free_shelf, is_in_doubt, is_taken, on_shelves
from labos.core.state import LabState
from labos.core.waits import Wait, describe_occupants, list_keys_until_free, list_party


def bind(state: LabState, run: RunState, step: PlanStep) -> Wait | tuple[AnyEffect, ...]:
    """Write into the effects which labware they touch, if all of them are possible now."""
    if not step.effects:
        return ()
    start = StartCheck(state, run, step)
    for effect in step.effects:
        wait = check_effect(start, effect)
        if wait is not None:
            return wait
        start.accept(effect)
    return (start.check_room_for_all() if start.bound else None) or tuple(start.bound)


def find_unfit_labware(state: LabState, run: RunState, step: PlanStep) -> Wait | None:
    """Why the labware at the places of a step does not meet the step's requirements; None if it does. Nothing
    that other runs do can change this."""
    start = StartCheck(state, run, step)
    for effect in step.effects:
        wait: Wait | None = None
        match effect:
            case Carrying() if effect.stands and not any(
                start.check_presence(effect, p) for p in effect.stands
            ):
                wait = start.check_fits(effect)
            case Needs():
                start.check_labware(effect)
            case Requires(of="labware"):
                wait = start.check_value(effect)
            case _:
                pass
        if wait is not None:
            return _make_final(wait)
        start.look_at(effect)
    return None


def _make_final(wait: Wait) -> Wait:
    """Mark a wait as final: only its own run may use the labware, so only a person can change its state."""
    if not isinstance(wait.reason, reasons.Requires):
        return wait
    return Wait(reasons.Unfit(*wait.reason.names), wait.on)


class StartCheck:
    """A step that is about to start, checked against the state: a store that returns the reason why the step
    waits. ``bound`` are the possible effects with their labware; ``subject`` is the labware of the last
    effect that named one."""

    def __init__(self, state: LabState, run: RunState, step: PlanStep) -> None:
        self.state, self.run, self.step = state, run, step
        self.bound: list[AnyEffect] = []
        self.subject: Labware | None = None
        self._found: dict[StationName, Labware] = {}
        self._used: set[LabwareId] = set()

    # -- what is in the way ----------------------------------------------------------------------

    def stock(self, what: Carrying, stack: StationName) -> Wait | None:
        station = self.state.bench.stations[stack]
        key = (station_key(stack),)
        if station.labware:
            return Wait(reasons.Buried(stack, station.labware[-1]), key)
        if stack in self.state.bench.uncertain_at:
            return Wait(reasons.Uncertain(stack), key)
        left = len(station.stock) - count_taking(self.state.bench, stack)
        if left <= 0:
            return Wait(reasons.StackEmpty(stack), key)
        alike = {*zip(station.stock[left - 1 :], station.lots[left - 1 :], strict=True)}
        if station.expected or len(alike) > 1:
            return Wait(reasons.ReachedInto(stack), list_keys_until_free(self.state, stack))
        return None

    def check_presence(self, what: Carrying, place: StationName) -> Wait | None:
        item = find_usable(self.state, self.run, place, self._used)
        if item is not None:
            self._found[place] = item
            return None
        if self._used and find_usable(self.state, self.run, place) is not None:
            # The other piece has been carried away before.
            return _explain_missing(self.state, self.run, place)
        return explain_missing(self.state, self.run, place)

    def check_fits(self, what: Carrying) -> Wait | None:
        if what.lid:
            plate = self._found[what.plate_at]
            if bool(plate.lid) != (what.lid == "off") or plate.lid in self._used:
                wanted = str(what.lid == "off")
                return Wait(reasons.Requires(plate.id, "lidded", wanted), (station_key(what.plate_at),))
        item = self._find_item(what)
        kind = item.type if item is not None else self._find_topmost_type(what.stock)
        wait = check_grip(self.state, self.step, what, kind) or check_accepts(self.state, what, kind)
        if wait is not None or item is None or what.lid:
            return wait
        return check_rotation(self.state, what, item)

    def check_hand(self, what: Carrying) -> Wait | None:
        return check_hand(self.state, self.step, what.source)

    def check_entry(self, what: Carrying, place: StationName) -> Wait | None:
        if place == what.stock:  # several items of one kind may be taken at a time
            return check_entry(self.state, self.run, place)
        return check_reachable(self.state, self.run, place)

    def check_room(self, what: Effect, place: StationName) -> Wait | None:
        return check_room(self.state, place)

    def check_labware(self, needs: Needs) -> Wait | None:
        places = [needs.station] if needs.station else self.state.bench.by_module.get(self.step.module, [])
        found = [item for p in places if (item := find_usable(self.state, self.run, p)) is not None]
        owners = list_party(self.run)
        self.subject = min(found, key=lambda item: owners.index(item.owner), default=None)
        if self.subject is not None:
            return None
        return explain_missing(self.state, self.run, places[0] if places else StationName(self.step.module))

    def check_value(self, requires: Requires) -> Wait | None:
        if requires.of == "module":
            value = self.state.modules.by_name[self.step.module].find_value(requires.variable)
            name, key = str(self.step.module), module_key(self.step.module)
        elif self.subject is not None:
            value = find_variable(self.subject, requires.variable)
            name, key = str(self.subject.id), station_key(self.subject.station)
        else:
            return None
        if is_same(value, requires.value):
            return None
        return Wait(reasons.Requires(name, requires.variable, str(requires.value)), (key,))

    def check_setpoint(self, claims: Claims) -> Wait | None:
        module = self.state.modules.by_name[self.step.module]
        wanted: dict[str, Any] = {}
        held = module.setpoints.get(claims.setpoint)
        if held is not None:
            wanted.update(dict.fromkeys(held.holders, held.value))
        for action in map(self.state.actions.open.__getitem__, module.in_flight):
            flying = compute_settings_after(action.effects).claims
            if claims.setpoint in flying:
                wanted[action.run] = flying[claims.setpoint]
        for holder, value in wanted.items():
            if holder != self.run.id and (value is None or value != claims.value):
                names = (self.step.module, claims.setpoint, str(value), run_owner(RunId(holder)))
                return Wait(reasons.Setpoint(*names), (module_key(self.step.module),))
        return None

    def check_amount(self, consumes: Consumes) -> Wait | None:
        """Whether enough for the whole step is left, besides the amounts that actions in flight may use."""
        left = find_unreserved(self.state, self.step.module, consumes.resource)
        if left is None or left >= sum_needed(self.step.effects, consumes.resource):
            return None
        names = (self.step.module, consumes.resource)
        return Wait(reasons.UsedUp(*names), (module_key(self.step.module),))

    def check_room_for_all(self) -> Wait | None:
        """Labware that fits piece by piece also has to fit together."""
        bench = self.state.bench
        for place, number in Counter(list_arrivals(self.bound)).items():
            station = bench.stations[place]
            together = number > 1 and station.count + number > station.spec.capacity
            if together or place in bench.shelves:  # no shelf was left for this one
                names = (place, f"{number} arrivals at once")
                return Wait(reasons.Occupied(*names), list_keys_until_free(self.state, place))
        for stack, number in Counter(effect.stock for effect in list_carried(self.bound)).items():
            if stack and number > len(bench.stations[stack].stock) - count_taking(bench, stack):
                return Wait(reasons.StackEmpty(stack), (station_key(stack),))
        return None

    # -- what is written in ----------------------------------------------------------------------

    def look_at(self, effect: AnyEffect) -> None:
        """Remember the labware of a carrying effect: later effects are about it."""
        if isinstance(effect, Carrying) and effect.stands:
            self.subject = self._found.get(effect.plate_at or effect.source)

    def accept(self, effect: AnyEffect) -> None:
        """Write the labware into an effect that is possible."""
        self.look_at(effect)
        touched: dict[str, LabwareId] = {}
        item = self._find_item(effect) if isinstance(effect, Carrying) else None
        match effect:
            case Unlid() | Relid() if item is not None and self.subject is not None:
                touched = {"labware": item.id, "plate": self.subject.id}
            case Move() if item is not None:
                touched = {"labware": item.id}
            case Requires(of="labware") | Sets(of="labware") | Needs() | Reads() | Transfers() | Draws():
                touched = {"labware": self.subject.id} if self.subject is not None else {}
            case _:
                pass
        if touched:
            effect = msgspec.structs.replace(effect, **touched)
        if item is not None:
            self._used.add(item.id)
        if self.state.bench.shelves:
            effect = on_shelves(self.state.bench, effect, list_arrivals(self.bound))
        self.bound.append(effect)

    def _find_item(self, what: Carrying) -> Labware | None:
        """The labware that is carried; None if it has no id yet."""
        if what.stock:
            return None
        if what.lid == "off":
            return self.state.bench.labware[self._found[what.plate_at].lid]
        return self._found[what.source]

    def _find_topmost_type(self, stack: StationName) -> str:
        """The type of the item that is taken off a stack."""
        left = len(self.state.bench.stations[stack].stock) - count_taking(self.state.bench, stack)
        return split_item(self.state.bench.stations[stack].stock[left - 1])[0]


def find_unreserved(state: LabState, module: ModuleName, resource: str) -> float | None:
    """The amount of a resource that remains after everything in flight; None if the amount was never
    declared."""
    left = state.resources.find_left(module, resource)
    if left is None:
        return None
    flying = map(state.actions.open.__getitem__, state.modules.by_name[module].in_flight)
    return left - sum(sum_needed(action.effects, resource) for action in flying)


def check_hand(state: LabState, step: PlanStep, source: StationName) -> Wait | None:
    """An arm that holds labware, or may still hold lost labware, carries nothing else: it may only put down
    the labware that it holds."""
    hand = name_hand(step.module)
    if hand in state.bench.uncertain_at:
        return Wait(reasons.Uncertain(hand), (station_key(hand),))
    station = state.bench.stations.get(hand)
    if station is not None and station.count and source != hand:
        return Wait(
            reasons.HandFull(step.module, describe_occupants(state, station)),
            list_keys_until_free(state, hand),
        )
    return None


def check_rotation(state: LabState, what: Carrying, labware: Labware) -> Wait | None:
    """Whether the labware would have A1 in the corner that its target requires."""
    wanted = state.bench.stations[what.target].spec.a1
    way = compute_a1_after(state.bench, what, labware)
    if wanted is None or way == wanted:
        return None
    names = (labware.id, what.target, str(way), str(wanted))
    return Wait(reasons.WrongWay(*names), (station_key(what.source),))


def check_grip(state: LabState, step: PlanStep, what: Carrying, labware_type: str) -> Wait | None:
    """Whether the arm can hold labware of this type with the step's grip, at the source and at the target."""
    for place, grip in ((what.source, what.source_grip), (what.target, what.target_grip)):
        grips = state.bench.stations[place].spec.list_grips(step.module, labware_type)
        if grip and grips and grip not in grips:
            names = (step.module, place, labware_type, grip, " or ".join(grips))
            return Wait(reasons.NoGrip(*names), (station_key(what.source),))
    return None


def check_accepts(state: LabState, what: Carrying, labware_type: str) -> Wait | None:
    """Whether the target accepts labware of the type."""
    for place in what.room:
        if not state.bench.stations[place].spec.admits(labware_type):
            return Wait(reasons.NotAccepted(place, labware_type), (station_key(place),))
    return None


def is_same(actual: Any, wanted: Any) -> bool:
    """Whether a variable has the wanted value; a variable that was never set counts as false."""
    return bool((actual if actual is not None else False) == wanted)


def find_usable(
    state: LabState,
    run: RunState,
    place: StationName,
    but: Collection[LabwareId] = (),
    *,
    lent: bool = False,
) -> Labware | None:
    """The labware at a station that this run may use and reach, except ``but``. The run's own labware comes
    before that of its experiment, of its user, and shared labware. On a stack only the topmost piece is
    reachable. A plate with a lost lid cannot be used. ``lent``: include labware that is lent to another run,
    as if this run had ended."""
    station = state.bench.stations.get(place)
    if station is None:
        return None
    labware = state.bench.labware
    reach = [name for name in station.labware if name not in but] if but else station.labware
    reach = reach[-1:] if station.spec.kind == "stack" else reach
    for owner in list_party(run):
        for name in reversed(reach):
            item = labware[name]
            whose = item.lender or item.owner if lent else item.owner
            if whose == owner and not state.bench.is_lid_in_doubt(item) and (lent or not item.moving):
                return item
    return None


def explain_missing(state: LabState, run: RunState, place: StationName) -> Wait:
    """Why there is no labware to use: it is uncertain, belongs to others, is in motion, or the station is
    empty."""
    station = state.bench.stations.get(place)
    key = (station_key(place),)
    if is_in_doubt(state.bench, place):
        return Wait(reasons.Uncertain(place), key)
    if station is not None and station.labware:
        labware = state.bench.labware[station.labware[-1]]
        if labware.moving:
            return Wait(reasons.InMotion(labware.id, place), list_keys_until_free(state, place))
        if labware.lender in list_party(run):
            return Wait(reasons.InUse(labware.id, place, labware.owner), key)
        return Wait(reasons.NotYours(labware.id, place, labware.owner or "nobody"), key)
    if station is not None and not station.known and not station.expected:
        return Wait(reasons.Undeclared(place), key)
    return _explain_missing(state, run, place)


def _explain_missing(state: LabState, run: RunState, place: StationName) -> Wait:
    """Nothing stands at a place, but labware of this run that is being carried may still arrive there."""
    on_its_way = any(item.moving for item in state.bench.list_owned(run_owner(run.id)))
    why = reasons.StillToCome(place) if on_its_way else reasons.NothingThere(place)
    return Wait(why, (station_key(place),))


def check_reachable(state: LabState, run: RunState, place: StationName) -> Wait | None:
    """Whether a manipulator may reach into a station; into a stack only if no other hand is there."""
    return check_stack_alone(state, place) or check_entry(state, run, place)


def check_entry(state: LabState, run: RunState, place: StationName) -> Wait | None:
    """Whether a station's module is accessible to a manipulator: idle, open, and not kept by another run."""
    spec = state.bench.stations[place].spec
    if not spec.module or spec.stands_apart:
        return None
    module = state.modules.by_name[spec.module]
    key = (module_key(spec.module),)
    if module.busy or module.status == ModuleStatus.BUSY:
        return Wait(reasons.ModuleBusy(spec.module), key)
    if module.cut_off:
        return check_module(module)
    shut = check_door_open(state, place)
    if shut:  # nobody opens the doors of a module that is down before a person has checked it
        return check_module(module) or shut
    if spec.claim:
        holder = find_other_holder(state, spec.module, run)
    else:  # with storage behind a door, only the door can be kept by a run
        holder = find_other_keeper(state, spec.module, run) if spec.access else ""
    return Wait(reasons.Held(spec.module, holder), key) if holder else None


def check_module(module: Module, *, recovers: bool = False) -> Wait | None:
    """Whether a person has to check a module first. An action that ``recovers`` it from an error need not
    wait."""
    name, key = module.spec.name, (module_key(module.spec.name),)
    if module.out_of_service:
        return Wait(reasons.OutOfService(name, module.out_of_service), key)
    if module.status == ModuleStatus.GONE or (module.status == ModuleStatus.ERROR and not recovers):
        return Wait(reasons.ModuleDown(name, module.status, module.error), key)
    return None


def check_stack_alone(state: LabState, place: StationName) -> Wait | None:
    """Only one hand at a time may use a stack of plates with ids: with two, nobody could say whose plate is
    on top. Several hands may take nameless items of one kind."""
    station = state.bench.stations[place]
    # Another question about this station is open.
    if station.spec.kind != "stack" or place in state.bench.uncertain_at:
        return None
    moving = any(state.bench.labware[name].moving for name in station.labware)
    if station.expected or moving or count_taking(state.bench, place):
        return Wait(reasons.ReachedInto(place), list_keys_until_free(state, place))
    return None


def check_door_open(state: LabState, place: StationName) -> Wait | None:
    """Whether the doors and lids in front of a station are out of the way."""
    spec = state.bench.stations[place].spec
    for variable, value in spec.access.items():
        if not is_same(state.modules.by_name[spec.module].find_value(variable), value):
            return Wait(reasons.NoAccess(place, variable, str(value)), (module_key(spec.module),))
    return None


def check_room(state: LabState, place: StationName) -> Wait | None:
    """Whether a station has room for one more piece."""
    station = state.bench.stations[place]
    key = (station_key(place),)
    if place in state.bench.shelves:
        return _check_room_on_shelves(state, place)
    if place in state.bench.uncertain_at:
        return Wait(reasons.Uncertain(place), key)
    if not station.known and not station.labware and station.spec.kind != "waste":
        return Wait(reasons.Undeclared(place), key)
    if station.full:
        if station.spec.kind == "waste":
            return Wait(reasons.WasteFull(place), key)
        return Wait(
            reasons.Occupied(place, describe_occupants(state, station)),
            list_keys_until_free(state, place),
        )
    return None


def _check_room_on_shelves(state: LabState, hotel: StationName) -> Wait | None:
    """Whether a shelf of a hotel is free."""
    bench = state.bench
    if find_free_shelf(bench, hotel) is not None:
        return None
    if is_taken(bench, hotel):
        names = (hotel, describe_occupants(state, bench.stations[hotel]))
        return Wait(reasons.Occupied(*names), list_keys_until_free(state, hotel))
    why = reasons.Uncertain(hotel) if is_in_doubt(bench, hotel) else reasons.Undeclared(hotel)
    return Wait(why, (station_key(hotel),))
