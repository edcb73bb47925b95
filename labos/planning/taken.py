"""What one step at a time may have, and where labware takes room."""

from __future__ import annotations

from labos.core.bench import StationState
from labos.core.effects import list_carried
from labos.core.ids import StationName, deck_key, module_key, split_key, station_key, zone_key
from labos.core.model import PlanStep
from labos.core.state import LabState
from labos.core.zones import find_zones


def list_taken(state: LabState, step: PlanStep) -> list[str]:
    """The keys of what one step at a time may have, as long as it lasts: its module and zones, the modules
    that a hand reaches into, and the place where it changes its grip."""
    found: dict[str, bool] = {}
    if step.exclusive:
        found[module_key(step.module)] = True
        found.update(dict.fromkeys(map(zone_key, find_zones(state, step.module, step.effects)), True))
    for what in list_carried(step.effects):
        if what.via:
            found[station_key(what.via)] = True
        for place in what.entered:
            spec = state.bench.stations[place].spec
            if spec.module and not spec.stands_apart:
                found[module_key(spec.module)] = True
    return list(found)


def list_counted_keys(state: LabState, place: StationName) -> list[str]:
    """The keys of what labware at a place takes room in: the place, and its deck; nothing where there is
    always room."""
    station = state.bench.stations.get(place)
    if station is None or station.spec.kind in ("stack", "waste"):
        return []
    keys = [station_key(place)]
    return [*keys, deck_key(station.spec.claim)] if station.spec.claim else keys


def is_deck(key: str) -> bool:
    return split_key(key)[0] == "deck"


def find_station(state: LabState, key: str) -> StationState | None:
    """The station whose key this is; None if it is the key of something else."""
    kind, name = split_key(key)
    return state.bench.stations.get(StationName(name)) if kind == "station" else None


def count_room(state: LabState, station: StationState) -> int:
    """How much labware there is room for at a station: in a hotel, on all its shelves."""
    shelves = state.bench.shelves.get(station.spec.name, [])
    return sum(state.bench.stations[shelf].spec.capacity for shelf in shelves) or station.spec.capacity
