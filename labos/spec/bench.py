"""The first contents of the stations."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from labos.core.bench import split_item
from labos.core.ids import ModuleName, StationName
from labos.core.model import StationSpec, Workcell
from labos.errors import SpecError
from labos.spec.findings import Remarks
from labos.spec.stations import Stations

DEFAULT_LABWARE, DEFAULT_LID = "plate96", "lid96"


class Stock(msgspec.Struct, frozen=True):
    """A number of pieces of a labware type at a station."""

    station: StationName
    labware: str
    count: int


class BenchFile(msgspec.Struct, frozen=True):
    """The contents of the stations when the lab is first declared; stations that are not named are empty. For
    a lab in operation, ``away_from_rest`` names the module variables that are not at their rest values now:
    their values at the start of a run are not known."""

    stock: tuple[Stock, ...] = ()
    away_from_rest: dict[ModuleName, tuple[str, ...]] = {}


def make_default_stock(workcell: Workcell, lid: str = "", room: int = 0) -> BenchFile:
    """Full stacks of plates for a simulated bench, if a file declares no stock. With ``lid``, the plates have
    lids of this type; ``room`` is the number of pieces for which room is left."""
    usual = f"{DEFAULT_LABWARE}+{lid}" if lid else DEFAULT_LABWARE
    return BenchFile(
        tuple(
            Stock(station.name, (station.accepts or (usual,))[0], max(station.capacity - room, 1))
            for station in workcell.stations
            if station.kind == "stack"
        )
    )


def read_stock(written: Mapping[str, Mapping[str, int]], stations: Stations, remarks: Remarks) -> BenchFile:
    """The ``stock:`` of a workcell file; faults go to the remarks."""
    found: list[Stock] = []
    for place, counts in written.items():
        path = ("stock", place)
        try:
            station = stations[stations.find(place)]
        except SpecError as error:
            remarks.error(error.message, path, error.remedy, key=True)
            continue
        _check(place, counts, station, remarks)
        shelves = stations.list_shelves(station.name)
        if shelves:
            pieces = [labware for labware, count in counts.items() for _ in range(count)]
            found += [Stock(shelf, piece, 1) for shelf, piece in zip(shelves, pieces, strict=False)]
            continue
        found += [Stock(station.name, labware, count) for labware, count in counts.items() if count]
    return BenchFile(tuple(found))


def _check(place: str, counts: Mapping[str, int], station: StationSpec, remarks: Remarks) -> None:
    total = sum(counts.values())
    if total > station.capacity:
        remarks.error(
            f"{place} holds {station.capacity}, not {total}.",
            ("stock", place),
            "Stock less, or give the station a greater `capacity:` under `stations:`.",
        )
    if station.kind == "waste" and total:
        remarks.error(f"{place} is waste and cannot be stocked.", ("stock", place), "Leave it out.", key=True)
    for labware in counts:
        if not station.admits(split_item(labware)[0]):
            stacked = split_item(labware)[0] in station.refuses
            remarks.error(
                f"{place} does not accept {labware!r}.",
                ("stock", place, labware),
                "Pieces of this type cannot be stacked."
                if stacked
                else f"It accepts {', '.join(station.accepts)}.",
                key=True,
            )
