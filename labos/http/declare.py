"""Declares the content of the bench: all stations or none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from labos.core.decide.composites import DeclareStations
from labos.core.decide.lab import DeclareStation
from labos.core.ids import StationName, local, workcell_of
from labos.core.shelves import spread
from labos.errors import BadInput
from labos.http.service import LabService


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
