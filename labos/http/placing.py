"""Labware that is put on the bench for a run: all of it and the run, or nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec

from labos.core.decide.stock import LoadStation
from labos.core.ids import StationName, local, workcell_of
from labos.errors import BadInput
from labos.http.limits import Name, Variables
from labos.http.stock import expect, put_there
from labos.spec import Bench, Stock

if TYPE_CHECKING:
    from labos.http.service import LabService


class Placing(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One piece of labware of a type, and the station on which it was put; ``variables`` say what it is:
    ``{"sealed": true}``."""

    station: Name
    labware: Name
    variables: Variables = {}


def loads_of(service: LabService, placings: Sequence[Placing], workcell: str, by: str) -> list[LoadStation]:
    """What somebody has put where: a command for each station. Raises NotFound, BadInput, and Refused if it
    cannot stand there."""
    loads: dict[StationName, LoadStation] = {}
    for placing in placings:
        service.expect_labware(placing.labware)
        written = placing.station
        name = service.station(f"{workcell}/{written}" if workcell and "/" not in written else written)
        there = loads.get(name)
        variables = placing.variables
        put_on = tuple(name for name in variables if variables[name])
        left_off = tuple(name for name in variables if not variables[name])
        alike = there is None or (there.labware, there.set, there.unset) == (
            placing.labware,
            put_on,
            left_off,
        )
        if there is not None and not alike:
            raise BadInput(
                f"On {local(name)}, {there.labware} and {placing.labware} are to be put at once."
                if there.labware != placing.labware
                else f"On {local(name)}, {there.labware} is to be put in two ways: {variables}.",
                remedy="Put them there one after the other: labos load STATION --type TYPE",
            )
        count = 1 if there is None else there.count + 1
        loads[name] = LoadStation(name, placing.labware, count, set=put_on, unset=left_off)
    for command in loads.values():
        expect(service, command, by)
    return list(loads.values())


def with_loads(bench: Bench, loads: Sequence[LoadStation]) -> Bench:
    """What the stacks will hold when this has been put on them."""
    held = {stock.station: stock.count for stock in bench.stock}
    on_top = {load.station: load for load in loads}
    kept = [stock for stock in bench.stock if stock.station not in on_top]
    new = [Stock(name, load.labware, load.count + held.get(name, 0)) for name, load in on_top.items()]
    return Bench((*kept, *new), bench.away_from_rest)


def put(service: LabService, loads: Sequence[LoadStation], by: str) -> None:
    """Put it on the simulated bench, if this is one. Nothing is waited for, so that nothing comes between
    what was checked and the commit that records it."""
    if service.parts.simulated:
        for command in loads:
            events = expect(service, command, by)
            put_there(service.parts.world(workcell_of(command.station)), command, events)
