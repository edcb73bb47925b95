"""What people bring to the bench and take away, by HTTP; a simulated bench is changed to match."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated

import msgspec

from labos.core.decide import Command, Rejection, decide
from labos.core.decide.stock import LoadStation, Replenish, UnloadStation
from labos.core.effects import Replaces
from labos.core.expiry import day_of
from labos.core.ids import ActionId, InterventionId, LabwareId, ModuleName, StationName, local, workcell_of
from labos.core.labware import LabwarePlaced, LabwareRemoved, StationUnloaded
from labos.core.model import Workcell
from labos.core.registry import Event
from labos.core.resources import ResourceReplenished
from labos.http.limits import Amount, Asker, Count, Name, says
from labos.node.world import World
from labos.runtime.kernel import error_of
from labos.services.truth import bench_name
from labos.spec.units import in_unit

if TYPE_CHECKING:
    from labos.http.service import LabService


class Load(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    station: Annotated[Name, says("the station")]
    labware: Annotated[Name, says("its type")]
    by: Asker = ""
    count: Annotated[Count, says("how many pieces; 1 if not said")] = 1
    lot: Annotated[Name, says("their lot, which each piece keeps as its variable `lot`")] = ""


class Unload(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """One piece by name, the topmost ``count``, or all if neither is named."""

    station: Annotated[Name, says("the station")]
    by: Asker = ""
    labware: Annotated[Name, says("one piece, by its id or barcode")] = ""
    count: Annotated[Count | None, says("or so many from the top; everything if neither is said")] = None


class Replenishment(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """``amount`` 0 is as much as there is room for, in ``unit`` (empty: the resource's own); ``instead``
    of what was left."""

    resource: Annotated[Name, says("which resource of the module")]
    by: Asker = ""
    amount: Annotated[Amount, says("in the resource's unit; as much as there is room for if not said")] = 0.0
    unit: Annotated[Name, says("of the amount, as `mL`; the resource's own if left out")] = ""
    lot: Annotated[Name, says("the lot of the new pack")] = ""
    expires: Annotated[Name, says("the date until which it is good, as `2027-05-31`")] = ""
    instead: Annotated[bool, says("what was left of the old packs was taken out; `false` if left out")] = (
        False
    )


async def load(service: LabService, told: Load, by: str) -> list[str]:
    """Labware was put on a station; returns the names it got (none on a stack). Raises Refused."""
    name = service.station(told.station)
    service.expect_labware(told.labware)
    command = LoadStation(name, told.labware, told.count, told.lot)
    found = expect(service, command, by)
    if service.parts.simulated:
        await asyncio.to_thread(put_there, service.parts.world(workcell_of(name)), command, found)
    events = await service.kernel.execute(command, by)
    return [event.labware for event in events if isinstance(event, LabwarePlaced)]


async def unload(service: LabService, told: Unload, by: str) -> tuple[list[str], int]:
    """Labware was taken away; returns its names, and how many pieces had none. Raises Refused."""
    name = service.station(told.station)
    labware = service.labware(told.labware).id if told.labware else LabwareId("")
    command = UnloadStation(name, by, labware, told.count)
    events = expect(service, command, by)
    station = service.kernel.state.bench.stations[name]
    gone = [event.labware for event in events if isinstance(event, LabwareRemoved)]
    nameless = sum(event.count for event in events if isinstance(event, StationUnloaded))
    if service.parts.simulated and station.spec.kind != "waste":
        # Bottom to top: nameless pieces first, then those with names, on the bench as in the log.
        bench, world = service.kernel.state.bench, service.parts.world(workcell_of(name))
        below = len(station.stock)
        places: dict[StationName, list[int]] = {}
        for item in gone:
            stands = bench.labware[item].station or name
            positions = places.setdefault(stands, [])
            positions.append(len(bench.stations[stands].stock) + bench.stations[stands].labware.index(item))
        if nameless:
            places.setdefault(name, []).extend(range(below - nameless, below))
        for place, positions in places.items():
            await asyncio.to_thread(_carry_away, world, bench_name(bench.stations[place].spec), positions)
    elif service.parts.simulated and nameless >= station.level:
        await asyncio.to_thread(service.parts.world(workcell_of(name)).empty, local(name))
    await service.kernel.execute(command, by)
    return [str(item) for item in gone], nameless


async def replenish(service: LabService, module: str, told: Replenishment, by: str) -> float:
    """More of a resource was put in; returns how much. Raises Refused."""
    name = service.module(module)
    today = day_of(service.kernel.clock.now_ns())
    units = service.kernel.state.modules.by_name[name].spec.units
    amount = in_unit(told.amount, told.unit, units.get(told.resource, ""), told.resource)
    pack = (amount, told.lot, told.expires, told.instead)
    command = Replenish(name, told.resource, *pack, today)
    (event,) = expect(service, command, by)
    assert isinstance(event, ResourceReplenished)
    # The amount is settled here: something may be used up before the command is carried out.
    command = msgspec.structs.replace(command, amount=event.amount)
    if service.parts.simulated:
        world = service.parts.world(workcell_of(name))
        had = world.left(local(name), told.resource) or 0.0 if told.instead else 0.0
        await asyncio.to_thread(world.supply, local(name), told.resource, event.amount - had)
    await service.kernel.execute(command, by)
    return event.amount


def refill_by_hand(service: LabService, name: InterventionId) -> None:
    """On a simulated bench, what a person was asked to replace is full when that is confirmed."""
    state = service.kernel.state
    question = state.interventions.open.get(name)
    action = state.actions.open.get(ActionId(question.subject)) if question is not None else None
    for effect in action.effects if action is not None else ():
        if not isinstance(effect, Replaces):
            continue
        module = ModuleName(effect.module)
        level = state.resources.of(module, effect.resource)
        if level is not None:
            world, device = service.parts.world(workcell_of(module)), local(module)
            left = world.left(device, effect.resource) or 0.0
            world.supply(device, effect.resource, level.capacity - left)


def put_there(world: World, command: LoadStation, events: Sequence[Event]) -> None:
    """Put on a simulated bench what a command loads: where its ``events`` say, shelf by shelf."""
    placed = [event.station for event in events if isinstance(event, LabwarePlaced) and not event.on]
    for place, count in Counter(placed or [command.station] * command.count).items():
        world.stock(local(place), command.labware, count)
        if "sealed" in command.set:
            world.work("person", "seal", local(place))


def expect(service: LabService, command: Command, by: str) -> list[Event]:
    """What somebody's command would do, without what follows from that; changes nothing. Raises Refused."""
    return list(check(service, command, by))


def check(service: LabService, command: Command, by: str) -> Iterable[Event]:
    """Raises Refused for a command that cannot be carried out. The events can be read only if none of them
    needs one before it, as those of composite commands do."""
    found = decide(service.kernel.state, command, by)
    if isinstance(found, Rejection):
        raise error_of(found)
    return found


def _carry_away(world: World, place: str, positions: list[int]) -> None:
    plates = world.at(place)
    for position in positions:
        if position < len(plates):
            world.carry(plates[position], "")


def furnish(world: World, cell: Workcell, stock: Mapping[StationName, list[str]]) -> None:
    """Make the simulated bench what the file says; what has been put there before stays."""
    stocked = {motion.place for motion in world.motions("stock")}
    for station in cell.places:
        place = local(station.name)
        if not world.is_furnished(place):
            world.furnish(place, station.capacity)
        if place not in stocked:
            for kind in stock.get(station.name, ()):
                world.stock(place, kind)
    for module in cell.modules:
        for resource, capacity in module.levels.items():
            if world.left(local(module.name), resource) is None:
                world.supply(local(module.name), resource, capacity)
    zones = {local(station.name): station.zone for station in cell.stations}
    zones |= {local(module.name): module.zone for module in cell.modules}
    for place, zone in zones.items():
        if zone:
            world.share(zone, place)
