"""Labware that is placed on the bench for a run: all pieces and the run are recorded, or nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec

from labos.core.bench import split_item
from labos.core.decide.stock import FOLLOWS, LoadStation
from labos.core.effects import Requires, Sets
from labos.core.ids import StationName, local
from labos.errors import BadInput
from labos.http.limits import Name, Variables
from labos.http.stock import check
from labos.spec import BenchFile, Stock
from labos.spec.about import find_description
from labos.spec.bench import DEFAULT_LID
from labos.spec.findings import suggest_name

if TYPE_CHECKING:
    from labos.http.service import LabService


class Placing(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One piece of labware of a type, and the station on which it was put; ``variables`` describe it:
    ``{"sealed": true}``."""

    station: Name
    labware: Name
    variables: Variables = {}


def make_loads(service: LabService, placings: Sequence[Placing], workcell: str, by: str) -> list[LoadStation]:
    """The commands for labware that a person has placed: one for each station. Raises NotFound, BadInput, and
    Refused if it cannot stand there."""
    loads: dict[StationName, LoadStation] = {}
    for placing in placings:
        written = placing.station
        name = service.station(f"{workcell}/{written}" if workcell and "/" not in written else written)
        there = loads.get(name)
        labware, variables = _read_placing(service, placing)
        service.expect_labware(labware)
        put_on = tuple(name for name in variables if variables[name])
        left_off = tuple(name for name in variables if not variables[name])
        alike = there is None or (there.labware, there.set, there.unset) == (labware, put_on, left_off)
        if there is not None and not alike:
            raise BadInput(
                f"{there.labware} and {labware} cannot both be put on {local(name)} at once."
                if there.labware != labware
                else f"On {local(name)}, {there.labware} is given twice with different values: {variables}.",
                remedy="Put them there one after the other: labos load STATION --type TYPE",
            )
        count = 1 if there is None else there.count + 1
        loads[name] = LoadStation(name, labware, count, set=put_on, unset=left_off)
    for command in loads.values():
        list(check(service, command, by))  # its events must be recordable, too
    return list(loads.values())


def _read_placing(service: LabService, placing: Placing) -> tuple[str, dict[str, bool]]:
    """The labware type with its lid, and the variables of a piece. Raises BadInput for a variable that no
    action in this lab uses."""
    variables, labware = dict(placing.variables), placing.labware
    is_lidded = variables.pop("lidded", None)
    if is_lidded is False and split_item(labware)[1]:
        raise BadInput(f"{labware} has a lid, but is given as not lidded.", remedy="Leave one of them out.")
    if is_lidded and not split_item(labware)[1]:
        labware = f"{labware}+{DEFAULT_LID}"
    known = {*_list_variables(service), *FOLLOWS}
    for name in variables:
        if name not in known:
            raise BadInput(
                f"No action of this lab asks whether labware is {name!r}.", remedy=suggest_name(name, known)
            )
    return labware, variables


def _list_variables(service: LabService) -> set[str]:
    """The variables of labware that the lab's actions need or set."""
    modules = service.kernel.state.modules.by_name.values()
    known = (find_description(module.spec, service.parts.descriptions) for module in modules)
    effects = (effect for about in known if about for spec in about.actions for effect in spec.effects)
    return {e.variable for e in effects if isinstance(e, Requires | Sets) and e.of == "labware"}


def with_loads(bench: BenchFile, loads: Sequence[LoadStation]) -> BenchFile:
    """The content of the stacks after these pieces have been placed."""
    held = {stock.station: stock.count for stock in bench.stock}
    on_top = {load.station: load for load in loads}
    kept = [stock for stock in bench.stock if stock.station not in on_top]
    new = [Stock(name, load.labware, load.count + held.get(name, 0)) for name, load in on_top.items()]
    return BenchFile((*kept, *new), bench.away_from_rest)
