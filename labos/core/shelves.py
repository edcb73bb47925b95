"""The shelves of a hotel that an arm reaches into: a plan names the hotel, a motion the shelf.

Which shelf it is follows when a step starts: where the labware stands that it takes, and the lowest one
that is free where it puts some down.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any

import msgspec

from labos.core.bench import Bench
from labos.core.effects import NOWHERE, AnyEffect, Move, Needs, Relid, Unlid
from labos.core.ids import LabwareId, StationName, local


def list_vacant(bench: Bench, hotel: StationName) -> list[StationName]:
    """The shelves of a hotel on which nothing stands, comes to stand or may stand; lowest first."""
    return [s for s in bench.shelves[hotel] if not bench.stations[s].count and s not in bench.haunted]


def find_free_shelf(
    bench: Bench, hotel: StationName, but: Collection[StationName] = ()
) -> StationName | None:
    """The lowest shelf that is known to be free, and none of ``but``."""
    return next((s for s in list_vacant(bench, hotel) if bench.stations[s].known and s not in but), None)


def is_taken(bench: Bench, hotel: StationName) -> bool:
    """Whether something certainly stands or comes to stand on a shelf: one that may be
    free again without anybody's help."""
    return any(bench.stations[s].count and s not in bench.haunted for s in bench.shelves[hotel])


def is_in_doubt(bench: Bench, place: StationName) -> bool:
    """Whether labware of uncertain place may stand at a place, or on one of its shelves."""
    return place in bench.haunted or any(s in bench.haunted for s in bench.shelves.get(place, ()))


def on_shelves(bench: Bench, effect: AnyEffect, but: Collection[StationName]) -> AnyEffect:
    """An effect whose labware is known, with shelves in place of hotels. Nothing is
    put on those of ``but``; where no other is ready, the hotel stays."""

    def stands(name: LabwareId) -> StationName:
        labware = bench.labware[name]
        return bench.labware[labware.on].station if labware.on else labware.station

    where: dict[str, Callable[[], StationName]] = {}
    match effect:
        case Unlid():
            where = {"source": lambda: stands(effect.plate)}
        case Relid():
            where = {"source": lambda: stands(effect.labware), "target": lambda: stands(effect.plate)}
        case Move():
            where = {"source": lambda: stands(effect.labware)}
        case Needs() if effect.labware:
            where = {"station": lambda: stands(effect.labware)}
    told = {field: find() for field, find in where.items() if getattr(effect, field) in bench.shelves}
    for field in ("target", "station"):
        place = getattr(effect, field, NOWHERE)
        if place in effect.room and place in bench.shelves:
            told[field] = find_free_shelf(bench, place, but) or place
    return msgspec.structs.replace(effect, **told) if told else effect


def spread(bench: Bench, place: StationName, items: Sequence[str]) -> list[tuple[StationName, Sequence[str]]]:
    """What stands at a place, bottom to top: of a hotel with shelves one piece on each shelf, lowest first,
    and what is too much on the last."""
    shelves = bench.shelves.get(place)
    if not shelves:
        return [(place, items)]
    last = len(shelves) - 1
    return [(shelf, items[n:] if n == last else items[n : n + 1]) for n, shelf in enumerate(shelves)]


def expand_hotels(
    planned: Sequence[AnyEffect], bound: Sequence[AnyEffect], args: dict[str, Any]
) -> dict[str, Any]:
    """Arguments that name hotels, with the shelves in their place."""
    shelves: dict[Any, str] = {}
    for before, after in zip(planned, bound, strict=True):
        for field in ("source", "target", "station"):
            hotel, shelf = getattr(before, field, ""), getattr(after, field, "")
            if hotel != shelf and hotel:
                shelves[local(hotel)] = local(shelf)
    if not shelves:
        return args
    return {name: shelves.get(v, v) if isinstance(v, str) else v for name, v in args.items()}
