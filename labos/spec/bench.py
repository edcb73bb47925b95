"""What stands where at first."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from labos.core.bench import split_item
from labos.core.ids import ModuleName, StationName
from labos.core.model import StationSpec, Workcell
from labos.errors import SpecError
from labos.spec.remarks import Remarks
from labos.spec.stations import Stations

DEFAULT_LABWARE, DEFAULT_LID = "plate96", "lid96"


class Stock(msgspec.Struct, frozen=True):
    """So many pieces of a labware type at a station."""

    station: StationName
    labware: str
    count: int


class BenchFile(msgspec.Struct, frozen=True):
    """What stands where when the lab is first declared; what is not named is empty. Of a lab that runs,
    ``away_from_rest`` names the variables of modules that are not as they are at rest now: how they will be
    when a run begins is not known."""

    stock: tuple[Stock, ...] = ()
    away_from_rest: dict[ModuleName, tuple[str, ...]] = {}


def make_default_stock(workcell: Workcell, lid: str = "", room: int = 0) -> BenchFile:
    """Every stack full of plates, with lids of a type if one is named, and with ``room`` for some more: a
    simulated bench for a file that declares no stock."""
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
                "One may not stand upon another." if stacked else f"It accepts {', '.join(station.accepts)}.",
                key=True,
            )
