"""Stations and labware: where labware stands, who owns it, and what is uncertain."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import msgspec

from labos.core.actions import ActionDiscovered, ActionEnd, ActionRequested
from labos.core.effects import (
    AnyEffect,
    Carrying,
    find_labware_used,
    list_carried,
    name_hand,
    turn,
)
from labos.core.ids import (
    NOBODY,
    ActionId,
    InterventionId,
    LabwareId,
    ModuleName,
    Owner,
    StationName,
    workcell_of,
)
from labos.core.interventions import InterventionRequested, InterventionResolved
from labos.core.lab import StationsApplied, WorkcellApplied
from labos.core.labware import (
    GONE,
    BarcodeRead,
    LabwareChanged,
    LabwareHandedOver,
    LabwareMoved,
    LabwareObserved,
    LabwarePlaced,
    LabwareRemoved,
    LabwareUncertain,
    LiquidDrawn,
    LiquidTransferred,
    SamplesRegistered,
    StationDeclared,
    StationLoaded,
    StationObserved,
    StationUnloaded,
    WasteEmptied,
)
from labos.core.model import StationSpec
from labos.core.registry import Event
from labos.core.topics import LostLabware, Unexpected
from labos.core.wells import add_doses, draw_doses

MOST_LOST = 100_000
"""If the log has lost its end, at most this number of pieces of labware got their ids in the lost part."""


class StationState(msgspec.Struct):
    """``labware`` lists the pieces with ids, bottom to top. ``stock`` lists the types of nameless items below
    them, bottom to top, and ``lots`` their lots (empty: not known). ``expected`` counts arrivals under way,
    and ``taking`` the items that actions in flight take off the stack. ``level`` counts the pieces in a
    waste. Labware that stands on a shelf, or is expected there, also counts for its hotel. A hotel is
    ``known`` when all its shelves are."""

    spec: StationSpec
    known: bool = False
    labware: list[LabwareId] = []
    stock: list[str] = []
    lots: list[str] = []
    expected: int = 0
    level: int = 0
    taking: int = 0

    @property
    def count(self) -> int:
        """The number of pieces that take up room here, arrivals under way included."""
        if self.spec.kind == "waste":
            return self.level + self.expected
        return len(self.labware) + len(self.stock) + self.expected

    @property
    def full(self) -> bool:
        return self.count >= self.spec.capacity


class Labware(msgspec.Struct):
    """``station`` is empty while the place is uncertain; ``maybe`` lists the possible places. ``moving``
    names the action that carries the labware or works on it. ``samples`` is the digest of its sample sheet;
    ``barcode`` is empty until one was read. ``volumes_ul`` is the most that its wells can hold at present,
    where that is known. ``lender`` is the owner that gets it back when the run that uses it has ended; empty
    if it is not lent.

    A lid ``on`` a plate has no station of its own: it is where the plate is, and the plate names it as its
    ``lid``. If the place of the lid is uncertain too, it may be elsewhere."""

    id: LabwareId
    type: str
    station: StationName
    owner: Owner = NOBODY
    variables: dict[str, Any] = {}
    maybe: tuple[StationName, ...] = ()
    moving: str = ""
    placed_at: int = 0
    samples: str = ""
    barcode: str = ""
    lid: LabwareId = LabwareId("")
    on: LabwareId = LabwareId("")
    volumes_ul: dict[str, float] = {}
    lender: Owner = NOBODY


class Bench(msgspec.Struct):
    """``uncertain_at`` counts uncertain labware by the stations where it may be. ``by_module``, ``by_owner``
    and ``watched`` (stations with an observer) are indexes. ``searched`` are places where a person was asked
    to look for an item from a stack. ``named`` counts the labware ids given out. ``barcodes`` finds labware
    on the bench by its barcode. ``shelves`` are the shelves of each hotel, lowest first. ``in_cell`` are the
    stations of each workcell. ``lost`` is the labware with an unknown place."""

    stations: dict[StationName, StationState] = {}
    labware: dict[LabwareId, Labware] = {}
    uncertain_at: dict[StationName, int] = {}
    by_module: dict[ModuleName, list[StationName]] = {}
    by_owner: dict[Owner, dict[LabwareId, bool]] = {}
    reserved: dict[ActionId, tuple[AnyEffect, ...]] = {}
    searched: dict[InterventionId, tuple[StationName, ...]] = {}
    named: int = 0
    barcodes: dict[str, LabwareId] = {}
    watched: dict[StationName, bool] = {}
    shelves: dict[StationName, list[StationName]] = {}
    in_cell: dict[str, dict[StationName, bool]] = {}
    lost: dict[LabwareId, bool] = {}

    def find_planned_place(self, place: StationName) -> StationName:
        """The place with the name that plans use: for a shelf its hotel, otherwise the place itself."""
        station = self.stations.get(place)
        return station.spec.hotel or place if station is not None else place

    @property
    def next_id(self) -> LabwareId:
        """The id for the next new piece of labware."""
        return LabwareId(f"P{self.named + 1}")

    def list_owned(self, owner: Owner) -> list[Labware]:
        """Labware of an owner, oldest first."""
        return [self.labware[name] for name in self.by_owner.get(owner, ())]

    def is_lid_in_doubt(self, labware: Labware) -> bool:
        """Whether it is uncertain that the plate has its lid."""
        return bool(labware.lid) and bool(self.labware[labware.lid].maybe)


def split_item(item: str) -> tuple[str, str]:
    """The type of a stock item and the type of its lid (empty: no lid), from ``plate96+lid96``."""
    labware_type, _, lid = item.partition("+")
    return labware_type, lid


def add_arrival(bench: Bench, plate: LabwarePlaced, lid: str) -> Iterator[Event]:
    """The events of labware that is new to the log, and of the lid on it. ``lid`` is the type of the lid;
    empty for none."""
    yield plate
    if lid:
        name, on = bench.next_id, plate.labware
        yield LabwarePlaced(name, plate.run, lid, plate.station, plate.owner, action=plate.action, on=on)


def remove_labware(
    bench: Bench, name: LabwareId, run: str, where: StationName, why: str, action: str = ""
) -> list[Event]:
    """The events with which labware leaves the bench, together with the lid on it."""
    labware = bench.labware.get(name)
    events: list[Event] = []
    if labware is not None and labware.lid and not bench.is_lid_in_doubt(labware):
        events.append(LabwareRemoved(labware.lid, run, GONE, f"{why}, on {name}", action))
    return [*events, LabwareRemoved(name, run, where, why, action)]


def compute_a1_after(bench: Bench, effect: Carrying, labware: Labware) -> int:
    """The rotation of labware in its nest after a motion, in degrees; it is 0 at first."""
    source, target = bench.stations[effect.source].spec, bench.stations[effect.target].spec
    return (int(labware.variables.get("a1") or 0) + turn(effect, source.rotation, target.rotation)) % 360


def find_variable(labware: Labware, name: str) -> Any:
    """The known value of a variable of labware. ``lidded`` is computed from its lid."""
    return bool(labware.lid) if name == "lidded" else labware.variables.get(name)


def fold_workcell_applied(bench: Bench, event: WorkcellApplied, at: int) -> None:
    """Modules that are taken away take their empty stations with them."""
    present = {spec.name for spec in event.modules}
    for module in [m for m in bench.by_module if workcell_of(m) == event.name and m not in present]:
        for name in bench.by_module.pop(module):
            if not bench.stations[name].labware:
                _take_away(bench, name)


def fold_stations_applied(bench: Bench, event: StationsApplied, at: int) -> None:
    for name in event.removed:
        station = _take_away(bench, name)
        if station is not None and name in bench.by_module.get(station.spec.module, []):
            bench.by_module[station.spec.module].remove(name)
    for spec in event.stations:
        known = bench.stations.get(spec.name)
        if known is None:
            bench.stations[spec.name] = StationState(spec=spec)
            bench.in_cell.setdefault(workcell_of(spec.name), {})[spec.name] = True
        else:
            if known.spec.module != spec.module and spec.name in bench.by_module.get(known.spec.module, []):
                bench.by_module[known.spec.module].remove(spec.name)
            known.spec = spec
        bench.watched.pop(spec.name, None)
        if spec.watched:
            bench.watched[spec.name] = True
        if spec.module and spec.name not in bench.by_module.setdefault(spec.module, []):
            bench.by_module[spec.module].append(spec.name)
        if spec.hotel and spec.name not in bench.shelves.setdefault(spec.hotel, []):
            bench.shelves[spec.hotel].append(spec.name)
            bench.stations[spec.hotel].known = False


def fold_station_declared(bench: Bench, event: StationDeclared, at: int) -> None:
    station = bench.stations[event.station]
    _set_known(bench, event.station)
    if station.spec.kind == "waste":
        station.level = len(event.contents)
    else:
        station.stock = list(event.contents)
        station.lots = [""] * len(event.contents)


def fold_station_loaded(bench: Bench, event: StationLoaded, at: int) -> None:
    station = bench.stations[event.station]
    station.stock += [event.type] * event.count
    station.lots += [event.lot] * event.count


def fold_station_unloaded(bench: Bench, event: StationUnloaded, at: int) -> None:
    station = bench.stations[event.station]
    if station.spec.kind == "waste":
        station.level -= event.count
        return
    del station.stock[len(station.stock) - event.count :]
    del station.lots[len(station.stock) :]


def fold_waste_emptied(bench: Bench, event: WasteEmptied, at: int) -> None:
    station = bench.stations[event.station]
    station.level, station.known = 0, True


def fold_labware_placed(bench: Bench, event: LabwarePlaced, at: int) -> None:
    if event.stack:
        bench.stations[event.stack].stock.pop()
        bench.stations[event.stack].lots.pop()
    labware = Labware(
        id=event.labware,
        type=event.type,
        station=StationName(""),
        owner=event.owner,
        variables={"lot": event.lot} if event.lot else {},
        placed_at=at,
    )
    bench.labware[event.labware] = labware
    _settle(bench, labware, event.station, event.on)
    bench.named = max(bench.named, _parse_number(event.labware))
    bench.by_owner.setdefault(event.owner, {})[event.labware] = True


def fold_labware_moved(bench: Bench, event: LabwareMoved, at: int) -> None:
    _settle(bench, bench.labware[event.labware], event.target, event.on)


def fold_labware_observed(bench: Bench, event: LabwareObserved, at: int) -> None:
    labware = bench.labware[event.labware]
    under = bench.labware.get(labware.on)
    beneath = under.id if under is not None and under.station == event.station else LabwareId("")
    _settle(bench, labware, event.station, beneath)


def fold_labware_removed(bench: Bench, event: LabwareRemoved, at: int) -> None:
    """A plate leaves with the lid on it; one that may be elsewhere stays in doubt."""
    labware = bench.labware[event.labware]
    lid = bench.labware.get(labware.lid)
    if lid is not None and lid.maybe:
        _separate(bench, lid)
    for item in (lid, labware) if lid is not None and not lid.maybe else (labware,):
        _lift(bench, item)
        _separate(bench, item)
        _remove_from_owner(bench, item)
        bench.barcodes.pop(item.barcode, None)
        del bench.labware[item.id]
    station = bench.stations.get(event.where)
    if station is not None and station.spec.kind == "waste":
        station.level += 1


def fold_labware_uncertain(bench: Bench, event: LabwareUncertain, at: int) -> None:
    labware = bench.labware[event.labware]
    _lift(bench, labware)
    if event.on:
        _lay_on(bench, labware, event.on)
    labware.maybe = event.places
    bench.lost[labware.id] = True
    _count_possible(bench, event.places)


def fold_station_observed(bench: Bench, event: StationObserved, at: int) -> None:
    """A station that was observed empty becomes known, even if nobody ever declared it."""
    if event.count == 0:
        _set_known(bench, event.station)


def fold_labware_changed(bench: Bench, event: LabwareChanged, at: int) -> None:
    bench.labware[event.labware].variables[event.variable] = event.value


def fold_barcode_read(bench: Bench, event: BarcodeRead, at: int) -> None:
    before = bench.barcodes.get(event.barcode)
    if before is not None:
        bench.labware[before].barcode = ""
    labware = bench.labware[event.labware]
    bench.barcodes.pop(labware.barcode, None)
    labware.barcode = event.barcode
    bench.barcodes[event.barcode] = event.labware


def fold_samples_registered(bench: Bench, event: SamplesRegistered, at: int) -> None:
    labware = bench.labware[event.labware]
    labware.samples = event.sheet
    labware.volumes_ul = {
        sample.well: sample.volume_ul for sample in event.wells if sample.volume_ul is not None
    }


def fold_liquid_transferred(bench: Bench, event: LiquidTransferred, at: int) -> None:
    labware = bench.labware.get(event.labware)
    if labware is not None:
        add_doses(labware.volumes_ul, event.wells, event.volumes_ul)


def fold_liquid_drawn(bench: Bench, event: LiquidDrawn, at: int) -> None:
    labware = bench.labware.get(event.labware)
    if labware is not None and event.certain:
        draw_doses(labware.volumes_ul, event.wells, event.volumes_ul)


def fold_labware_handed_over(bench: Bench, event: LabwareHandedOver, at: int) -> None:
    """The lid on a plate has the same owner as the plate."""
    labware = bench.labware[event.labware]
    for item in (labware, bench.labware[labware.lid]) if labware.lid else (labware,):
        if not event.lent:
            item.lender = NOBODY
        elif item.owner != event.owner:
            item.lender = item.owner
        _remove_from_owner(bench, item)
        item.owner = event.owner
        bench.by_owner.setdefault(event.owner, {})[item.id] = True


def fold_intervention_requested(bench: Bench, event: InterventionRequested, at: int) -> None:
    """An item that was only partly taken off its stack has no id yet, but it is on the bench. The same holds
    for labware that an observer saw at a station that should be empty."""
    hand, places = name_hand(event.module), []
    match event.topic:
        case LostLabware():
            takes = [effect for effect in list_carried(event.topic.motions) if effect.stock]
            places = [place for take in takes for place in (take.source, hand, take.target)]
        case Unexpected():
            places = [event.topic.station]
        case _:
            pass
    if places:
        bench.searched[event.intervention] = tuple(places)
        _count_possible(bench, tuple(places))


def fold_intervention_resolved(bench: Bench, event: InterventionResolved, at: int) -> None:
    _clear(bench, bench.searched.pop(event.intervention, ()))


def fold_action_requested(bench: Bench, event: ActionRequested, at: int) -> None:
    if event.action in bench.reserved:
        return  # another attempt at the same action
    bench.reserved[event.action] = event.effects
    if not event.effects:
        return
    _expect(bench, event.effects, 1)
    for effect in event.effects:
        if effect.stock and isinstance(effect, Carrying):
            bench.named = max(bench.named, _parse_number(effect.labware))
    for name in find_labware_used(event.effects):
        bench.labware[name].moving = event.action


def fold_action_discovered(bench: Bench, event: ActionDiscovered, at: int) -> None:
    """Labware that got its id in the lost end of a log keeps this id. A number that is too large for any log
    is ignored."""
    for effect in event.effects or ():
        number = _parse_number(getattr(effect, "labware", LabwareId("")))
        if bench.named < number <= bench.named + MOST_LOST:
            bench.named = number


def fold_action_ended(bench: Bench, event: ActionEnd, at: int) -> None:
    """The reservations of the action are released; its effects follow as separate events."""
    effects = bench.reserved.pop(event.action, ())
    if not effects:
        return
    _expect(bench, effects, -1)
    for name in find_labware_used(effects):
        labware = bench.labware.get(name)
        if labware is not None and labware.moving == event.action:
            labware.moving = ""


def _expect(bench: Bench, effects: Iterable[AnyEffect], change: int) -> None:
    """Change the number of expected arrivals at the places where an action needs room, and of items that it
    takes off a stack."""
    for effect in effects:
        for place in effect.room:
            for station in _list_rooms(bench, place):
                station.expected += change
        if effect.stock:
            bench.stations[effect.stock].taking += change


def count_taking(bench: Bench, stack: StationName) -> int:
    """The number of items of a stack that actions in flight will take."""
    station = bench.stations.get(stack)
    return station.taking if station is not None else 0


def _settle(bench: Bench, labware: Labware, station: StationName, on: str = "") -> None:
    _lift(bench, labware)
    _separate(bench, labware)
    _set_known(bench, station)
    if on:
        _lay_on(bench, labware, LabwareId(on))
    else:
        labware.station = station
        for room in _list_rooms(bench, station):
            room.labware.append(labware.id)


def _lay_on(bench: Bench, lid: Labware, plate: LabwareId) -> None:
    _separate(bench, lid)
    lid.on = plate
    bench.labware[plate].lid = lid.id


def _separate(bench: Bench, lid: Labware) -> None:
    """Separate a lid from the plate on which it lay."""
    if lid.on:
        bench.labware[lid.on].lid = LabwareId("")
        lid.on = LabwareId("")


def _lift(bench: Bench, labware: Labware) -> None:
    if labware.station:
        for room in _list_rooms(bench, labware.station):
            room.labware.remove(labware.id)
        labware.station = StationName("")
    _clear(bench, labware.maybe)
    labware.maybe = ()
    bench.lost.pop(labware.id, None)


def _list_rooms(bench: Bench, place: StationName) -> tuple[StationState, ...]:
    """A station, and its hotel if it is a shelf."""
    station = bench.stations[place]
    return (station, bench.stations[station.spec.hotel]) if station.spec.hotel else (station,)


def _set_known(bench: Bench, place: StationName) -> None:
    """Record that the content of a station is known."""
    station = bench.stations[place]
    station.known = True
    hotel = station.spec.hotel
    if hotel and not bench.stations[hotel].known:
        bench.stations[hotel].known = all(bench.stations[shelf].known for shelf in bench.shelves[hotel])


def _take_away(bench: Bench, name: StationName) -> StationState | None:
    """Take labware away from its station, and return the station."""
    station = bench.stations.pop(name, None)
    bench.in_cell.get(workcell_of(name), {}).pop(name, None)
    bench.watched.pop(name, None)
    bench.shelves.pop(name, None)
    if station is not None and name in bench.shelves.get(station.spec.hotel, ()):
        bench.shelves[station.spec.hotel].remove(name)
    return station


def _count_possible(bench: Bench, places: tuple[StationName, ...]) -> None:
    for place in places:
        bench.uncertain_at[place] = bench.uncertain_at.get(place, 0) + 1


def _clear(bench: Bench, places: tuple[StationName, ...]) -> None:
    for place in places:
        bench.uncertain_at[place] -= 1
        if not bench.uncertain_at[place]:
            del bench.uncertain_at[place]


def _parse_number(name: LabwareId) -> int:
    return int(name[1:]) if name[1:].isdigit() else 0


def _remove_from_owner(bench: Bench, labware: Labware) -> None:
    owned = bench.by_owner[labware.owner]
    del owned[labware.id]
    if not owned:
        del bench.by_owner[labware.owner]
