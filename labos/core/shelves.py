"""The shelves of a hotel into which an arm reaches: a plan names the hotel, a motion names the shelf.

The shelf is chosen when a step starts. Labware is taken from the shelf on which it stands, and is put on the
lowest free one.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import msgspec

from labos.core.bench import Bench
from labos.core.effects import NOWHERE, AnyEffect, Move, Needs, Relid, Unlid
from labos.core.ids import LabwareId, StationName, local


def list_vacant(bench: Bench, hotel: StationName) -> list[StationName]:
    """The shelves of a hotel without labware, expected labware or possible labware; lowest first."""
    return [s for s in bench.shelves[hotel] if not bench.stations[s].count and s not in bench.uncertain_at]


def find_free_shelf(
    bench: Bench, hotel: StationName, but: Collection[StationName] = ()
) -> StationName | None:
    """The lowest shelf that is known to be free and not among ``but``."""
    return next((s for s in list_vacant(bench, hotel) if bench.stations[s].known and s not in but), None)


def is_taken(bench: Bench, hotel: StationName) -> bool:
    """Whether a shelf has, or will certainly get, labware. Such a shelf may become free again without a
    person."""
    return any(bench.stations[s].count and s not in bench.uncertain_at for s in bench.shelves[hotel])


def is_in_doubt(bench: Bench, place: StationName) -> bool:
    """Whether labware with an uncertain place may stand at this place, or on one of its shelves."""
    return place in bench.uncertain_at or any(s in bench.uncertain_at for s in bench.shelves.get(place, ()))


def on_shelves(bench: Bench, effect: AnyEffect, but: Collection[StationName]) -> AnyEffect:
    """The effect, whose labware is known, with shelves instead of hotels. Shelves in ``but`` are not used as
    targets. If no other shelf is free, the hotel stays in the effect."""

    def stands(name: LabwareId) -> StationName:
        labware = bench.labware[name]
        return bench.labware[labware.on].station if labware.on else labware.station

    standing: dict[str, LabwareId] = {}
    match effect:
        case Unlid():
            standing = {"source": effect.plate}
        case Relid():
            standing = {"source": effect.labware, "target": effect.plate}
        case Move():
            standing = {"source": effect.labware}
        case Needs() if effect.labware:
            standing = {"station": effect.labware}
    changes = {
        field: stands(name) for field, name in standing.items() if getattr(effect, field) in bench.shelves
    }
    for field in ("target", "station"):
        place = getattr(effect, field, NOWHERE)
        if place in effect.room and place in bench.shelves:
            changes[field] = find_free_shelf(bench, place, but) or place
    return msgspec.structs.replace(effect, **changes) if changes else effect


def spread(bench: Bench, place: StationName, items: Sequence[str]) -> list[tuple[StationName, Sequence[str]]]:
    """The labware at a place, bottom to top. For a hotel with shelves: one piece on each shelf, lowest first,
    and the surplus on the last one."""
    shelves = bench.shelves.get(place)
    if not shelves:
        return [(place, items)]
    last = len(shelves) - 1
    return [(shelf, items[n:] if n == last else items[n : n + 1]) for n, shelf in enumerate(shelves)]


def expand_hotels(
    planned: Sequence[AnyEffect], bound: Sequence[AnyEffect], args: dict[str, Any]
) -> dict[str, Any]:
    """Arguments with shelves instead of the hotels that they name."""
    shelves: dict[Any, str] = {}
    for before, after in zip(planned, bound, strict=True):
        for field in ("source", "target", "station"):
            hotel, shelf = getattr(before, field, ""), getattr(after, field, "")
            if hotel != shelf and hotel:
                shelves[local(hotel)] = local(shelf)
    if not shelves:
        return args
    return {name: shelves.get(v, v) if isinstance(v, str) else v for name, v in args.items()}
