"""Supplies that people bring to the bench or take away: consumables, stacks of labware, full wastes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import chain, islice

from labos.core.bench import StationState, add_arrival, count_taking, split_item
from labos.core.decide._base import Command, Decision, Rejection, decides
from labos.core.decide.by_hand import withdraw_answered
from labos.core.decide.lookups import decides_about, expect_station, find_living_owner
from labos.core.effects import list_carried
from labos.core.expiry import DATE, find_first_expired
from labos.core.ids import (
    SHARED,
    LabwareId,
    ModuleName,
    RunId,
    StationName,
    local,
    split_level_key,
)
from labos.core.labware import (
    LabwareChanged,
    LabwarePlaced,
    LabwareRemoved,
    StationDeclared,
    StationLoaded,
    StationUnloaded,
)
from labos.core.model import PlanStep
from labos.core.registry import Event
from labos.core.resources import Level, ResourceReplenished, sum_needed
from labos.core.runs import PENDING, SETTLED
from labos.core.shelves import list_vacant
from labos.core.state import LabState

MOST_AWAITED = 100
"""The most waiting runs that one event names."""

MOST_AT_ONCE = 200
"""The most pieces of labware that get their ids in one command."""


FOLLOWS = {
    "lidded": "Put it there with its lid: plate96+lid96.",
    "a1": "LabOS derives it from the nest.",
    "lot": "Name its lot: labos load STATION --type TYPE --lot LOT",
}
"""Variables of labware that are computed from other data, and how people change them."""


class Replenish(Command, frozen=True):
    """Report that a resource was refilled: by an amount, or to its capacity (0). ``instead``: the rest was
    taken out before. ``today`` is the date for the check of expiry dates (empty: no check)."""

    module: ModuleName
    resource: str
    amount: float = 0.0
    lot: str = ""
    expires: str = ""
    instead: bool = False
    today: str = ""


class LoadStation(Command, frozen=True):
    """Report that labware of a type was put on top of a station. In a hotel with shelves, each piece goes to
    the lowest free shelf. ``set`` are variables that are true for each piece (``sealed``); ``unset`` are
    variables that are false."""

    station: StationName
    labware: str
    count: int
    lot: str = ""
    set: tuple[str, ...] = ()
    unset: tuple[str, ...] = ()


class UnloadStation(Command, frozen=True):
    """Report that labware was taken away from a station: one piece by its id, the topmost ``count``, or all
    (neither given)."""

    station: StationName
    by: str
    labware: LabwareId = LabwareId("")
    count: int | None = None


@decides(Replenish)
def replenish(state: LabState, command: Replenish) -> Decision:
    module, resource = command.module, command.resource
    level = state.resources.find(module, resource)
    if module not in state.modules.by_name:
        return Rejection("no_module", f"There is no module {local(module)}.")
    if level is None:
        known = [name for where, name in map(split_level_key, state.resources.levels) if where == module]
        return Rejection(
            "no_resource",
            f"{local(module)} uses no {resource!r}.",
            f"It uses {', '.join(known)}." if known else "It uses nothing up.",
        )
    if command.expires and not DATE.fullmatch(command.expires):
        return Rejection("bad_date", f"{command.expires!r} is not a date.", "Write it like 2027-05-31.")
    flying = map(state.actions.open.__getitem__, state.modules.by_name[module].in_flight)
    if command.instead and any(sum_needed(action.effects, resource) for action in flying):
        return Rejection(
            "in_use",
            f"{local(module)} is using {resource} at the moment.",
            "Wait until its action has ended.",
        )
    had = 0.0 if command.instead else level.level
    room = level.capacity - had
    amount = command.amount or room
    if command.amount < 0 or amount <= 0:
        full = f"{local(module)} is full of {resource}: it holds {level.capacity:g}."
        return Rejection("bad_level", "A negative amount cannot be added." if command.amount else full)
    if amount > room:
        return Rejection(
            "too_many",
            f"{local(module)} holds {level.capacity:g} of {resource} and now has {had:g}: {amount:g} "
            "more do not fit.",
            f"Put in {room:g} at most.",
        )
    awaited = _find_waiting(state, lambda step: _lacks(step, level, module, resource, command.today))
    put_in = (amount, command.lot, command.expires, awaited, command.instead)
    return [ResourceReplenished(module, resource, *put_in)]


def _expect_free_of_doubt(state: LabState, command: LoadStation | UnloadStation) -> StationState | Rejection:
    """A station at which no arm is at work and no uncertain labware may stand."""
    name, station = command.station, expect_station(state, command)
    if isinstance(station, Rejection):
        return station
    if name in state.bench.uncertain_at:
        return Rejection(
            "uncertain",
            f"It is not yet known what stands at {local(name)}.",
            "Answer the open intervention first.",
        )
    if station.expected or count_taking(state.bench, name):
        return Rejection("in_motion", f"An arm is working at {local(name)}.", "Wait until it has ended.")
    return station


@decides_about(LoadStation, _expect_free_of_doubt)
def load_station(state: LabState, command: LoadStation, found: StationState) -> Decision:
    def takes(step: PlanStep) -> bool:
        return any(what.stock == command.station for what in list_carried(step.effects))

    name, spec = local(command.station), found.spec
    if spec.kind in ("waste", "gripper"):
        return Rejection("not_accepted", f"{name} is a {spec.kind}: labware cannot be loaded there.")
    kind = split_item(command.labware)[0]
    if not spec.admits(kind):
        return Rejection("not_accepted", f"{name} {spec.explain_refusal(kind)}.")
    shelves = list_vacant(state.bench, command.station) if command.station in state.bench.shelves else None
    room = spec.capacity - found.count if shelves is None else len(shelves)
    if not room and found.labware:
        held = ", ".join(found.labware[-3:])
        return Rejection(
            "too_many", f"{name} is full: it holds {held}.", f"Unload it first: labos unload {name}."
        )
    if not 0 < command.count <= room:
        return Rejection(
            "too_many",
            f"{name} has room for {room} more, not for {command.count}.",
            f"Load {room} at most." if room else "Unload it first.",
        )
    places = shelves[: command.count] if shelves is not None else [command.station] * command.count
    unknown = [place for place in dict.fromkeys(places) if not state.bench.stations[place].known]
    events: list[Event] = [StationDeclared(place, ()) for place in unknown]
    if variable := next((name for name in (*command.set, *command.unset) if name in FOLLOWS), ""):
        remedy = FOLLOWS[variable]
        return Rejection("not_accepted", f"{variable!r} of labware cannot be set here.", remedy)
    if spec.kind == "stack":
        if command.set or command.unset:
            names = ", ".join((*command.set, *command.unset))
            return Rejection(
                "not_accepted",
                f"Labware in {name} gets its id when it is taken, so {names} cannot be set for it.",
                "Put it at another station.",
            )
        if found.labware:
            return Rejection(
                "station_occupied",
                f"{found.labware[-1]} stands on top of {name}.",
                f"Take it away first: labos unload {name} {found.labware[-1]}.",
            )
        awaited = () if found.stock else _find_waiting(state, takes)
        loaded = StationLoaded(command.station, command.labware, command.count, command.lot, awaited)
        return [*events, loaded]
    if command.count > MOST_AT_ONCE:
        return Rejection(
            "too_many",
            f"{command.count} pieces at once are too many.",
            f"Load at most {MOST_AT_ONCE} at once.",
        )
    return chain(events, _place(state, command, places))


def _place(state: LabState, command: LoadStation, places: Sequence[StationName]) -> Iterator[Event]:
    kind, lid = split_item(command.labware)
    for place in places:
        item = state.bench.next_id
        plate = LabwarePlaced(item, "", kind, place, SHARED, lot=command.lot)
        yield from add_arrival(state.bench, plate, lid)
        for variable in (*command.set, *command.unset):
            yield LabwareChanged(item, "", variable, variable in command.set)


@decides(UnloadStation)
def unload_station(state: LabState, command: UnloadStation) -> Decision:
    def throws_away(step: PlanStep) -> bool:
        return any(what.filled == command.station for what in list_carried(step.effects))

    station = state.bench.stations.get(command.station)
    waste = station is not None and station.spec.kind == "waste"
    # Labware in a waste has left the bench. So labware that is being discarded, or may have been, is not
    # taken out of the waste.
    found = station if waste and station is not None else _expect_free_of_doubt(state, command)
    if isinstance(found, Rejection):
        return found
    name = local(command.station)
    nameless = found.level if waste else len(found.stock)
    if command.labware:
        named, count = [command.labware], 0
        if command.labware not in found.labware:
            here = ", ".join(found.labware) or "no labware with a name"
            return Rejection("not_there", f"{command.labware} does not stand at {name}; {here} stands there.")
    else:
        there = nameless + len(found.labware)
        wanted = there if command.count is None else command.count
        if not 0 < wanted <= there:
            return Rejection("too_many", f"{name} holds {there}.", "Unload what is there." if there else "")
        named = found.labware[::-1][:wanted]
        count = wanted - len(named)
    for item in named:
        if state.bench.labware[item].moving:
            return Rejection("in_motion", f"{item} is in motion at {name}.", "Wait until it has stopped.")
        owner = state.bench.labware[item].owner
        if find_living_owner(state, owner) is not None:
            return Rejection(
                "in_use",
                f"{item} at {name} belongs to {owner.replace(':', ' ')}, which has not ended.",
                "Wait for its end, or cancel it first.",
            )
    why = f"unloaded ({command.by})"
    stands = state.bench.labware
    events: list[Event] = [LabwareRemoved(item, "", stands[item].station, why) for item in named]
    if count:
        awaited = _find_waiting(state, throws_away) if waste and found.full else ()
        events.append(StationUnloaded(command.station, count, awaited))
    return [*withdraw_answered(state, events, command.by), *events]


def _find_waiting(state: LabState, lacks: Callable[[PlanStep], bool]) -> tuple[RunId, ...]:
    """The runs under way whose next step lacks something; the first ones if there are many."""
    waiting = (
        run.id
        for run in state.runs.active.values()
        for index, step in enumerate(state.runs.plan_of(run).steps)
        if run.steps[index].status == PENDING
        and all(run.steps[i].status in SETTLED for i in step.after)
        and lacks(step)
    )
    return tuple(islice(waiting, MOST_AWAITED))


def _lacks(step: PlanStep, level: Level, module: ModuleName, resource: str, today: str) -> bool:
    if step.module != module:
        return False
    amount = sum_needed(step.effects, resource)
    return amount > level.level or find_first_expired(level, amount, today) is not None
