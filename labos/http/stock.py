"""Labware and material that people bring to the bench and take away, over HTTP."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated

import msgspec

from labos.core.days import day_of
from labos.core.decide import Command, Rejection, decide
from labos.core.decide.composites import DeclareStations
from labos.core.decide.lab import DeclareStation
from labos.core.decide.stock import LoadStation, Replenish, UnloadStation
from labos.core.ids import LabwareId, StationName, local, workcell_of
from labos.core.labware import LabwarePlaced, LabwareRemoved, StationUnloaded
from labos.core.registry import Event
from labos.core.resources import ResourceReplenished
from labos.core.shelves import spread
from labos.errors import BadInput
from labos.http.limits import Amount, Asker, Count, Name, says
from labos.runtime.kernel import make_error
from labos.spec.units import in_unit

if TYPE_CHECKING:
    from labos.http.service import LabService


class LabwarePlacement(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    station: Annotated[Name, says("the station")]
    labware: Annotated[Name, says("its type")]
    by: Asker = ""


class Load(LabwarePlacement, kw_only=True):
    count: Annotated[Count, says("the number of pieces; 1 if left out")] = 1
    lot: Annotated[Name, says("their lot, which each piece keeps as its variable `lot`")] = ""


class Unload(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """One piece by name, the topmost ``count``, or all if neither is given."""

    station: Annotated[Name, says("the station")]
    by: Asker = ""
    labware: Annotated[Name, says("one piece, by its id or barcode")] = ""
    count: Annotated[
        Count | None, says("or this number of pieces from the top; everything if neither is given")
    ] = None


class Replenishment(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """``amount`` 0 fills all free room, in ``unit`` (empty: the resource's own); ``instead``: it replaces the
    rest of the old content."""

    resource: Annotated[Name, says("which resource of the module")]
    by: Asker = ""
    amount: Annotated[
        Amount, says("in the unit of the resource; if left out, as much as there is room for")
    ] = 0.0
    unit: Annotated[
        Name, says("the unit of the amount, such as `mL`; the unit of the resource if left out")
    ] = ""
    lot: Annotated[Name, says("the lot of the new pack")] = ""
    expires: Annotated[Name, says("the expiry date, such as `2027-05-31`")] = ""
    instead: Annotated[bool, says("the rest of the old packs was taken out; `false` if left out")] = False


async def load(service: LabService, request: Load, by: str) -> list[str]:
    """Labware was put on a station; returns the ids that it got (none on a stack). Raises Refused."""
    name = service.station(request.station)
    service.expect_labware(request.labware)
    events = await service.kernel.execute(LoadStation(name, request.labware, request.count, request.lot), by)
    return [event.labware for event in events if isinstance(event, LabwarePlaced)]


async def unload(service: LabService, request: Unload, by: str) -> tuple[list[str], int]:
    """Labware was taken away; returns its ids, and the number of pieces without one. Raises Refused."""
    name = service.station(request.station)
    labware = service.labware(request.labware).id if request.labware else LabwareId("")
    command = UnloadStation(name, by, labware, request.count)
    events = await service.kernel.execute(command, by)
    gone = [event.labware for event in events if isinstance(event, LabwareRemoved)]
    nameless = sum(event.count for event in events if isinstance(event, StationUnloaded))
    return [str(item) for item in gone], nameless


async def replenish(service: LabService, module: str, request: Replenishment, by: str) -> float:
    """A resource was replenished; returns the amount. Raises Refused."""
    name = service.module(module)
    today = day_of(service.kernel.clock.now_ns())
    units = service.kernel.state.modules.by_name[name].spec.units
    amount = in_unit(request.amount, request.unit, units.get(request.resource, ""), request.resource)
    pack = (amount, request.lot, request.expires, request.instead)
    command = Replenish(name, request.resource, *pack, today)
    events = await service.kernel.execute(command, by)
    return sum(event.amount for event in events if isinstance(event, ResourceReplenished))


async def declare_bench(
    service: LabService, contents: Mapping[str, Sequence[str]], workcell: str, by: str, *, empty: bool
) -> dict[str, list[str]]:
    """Declare the content of stations, bottom to top; with ``empty``, stations without a declaration are
    empty. Returns what was declared. Raises Refused, NotFound, BadInput."""
    bench = service.kernel.state.bench
    stations: dict[StationName, tuple[str, ...]] = {}
    for name, types in contents.items():
        station = service.station(name)
        if station in stations or any(shelf in stations for shelf in bench.shelves.get(station, ())):
            raise BadInput(f"{local(station)} is declared twice.", remedy="Declare it once.")
        for labware in types:
            service.expect_labware(labware)
        stations |= {shelf: tuple(some) for shelf, some in spread(bench, station, types)}
    if empty:
        cell = service.workcell(workcell).name
        for name, known in bench.stations.items():
            unheard = not known.known and known.spec.kind not in ("gripper", "waste")
            if workcell_of(name) == cell and unheard and name not in bench.shelves:
                stations.setdefault(name, ())
    command = DeclareStations(tuple(DeclareStation(name, types) for name, types in stations.items()))
    await service.kernel.execute(command, by)
    return {local(name): list(types) for name, types in stations.items()}


def check(service: LabService, command: Command, by: str) -> Iterable[Event]:
    """Raises Refused for a command that cannot be carried out. The events can be read only if none of them
    depends on an earlier one, as in composite commands."""
    found = decide(service.kernel.state, command, by)
    if isinstance(found, Rejection):
        raise make_error(found)
    return found
