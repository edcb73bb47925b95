"""What only one step at a time may use, and where labware takes up room."""

from __future__ import annotations

from labos.core.bench import StationState
from labos.core.effects import list_carried
from labos.core.ids import StationName, deck_key, module_key, split_key, station_key, zone_key
from labos.core.model import PlanStep
from labos.core.state import LabState
from labos.core.zones import find_zones


def list_taken(state: LabState, step: PlanStep) -> list[str]:
    """The keys of what only one step at a time may use, for the duration of this step: its module and zones,
    the modules into which a hand reaches, and the station at which it changes its grip."""
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
    """The keys of what labware at a place takes up room in: the place and its deck. Empty if there is always
    room, or if the station is unknown."""
    station = state.bench.stations.get(place)
    if station is None or station.spec.kind in ("stack", "waste"):
        return []
    keys = [station_key(place)]
    return [*keys, deck_key(station.spec.claim)] if station.spec.claim else keys


def is_deck(key: str) -> bool:
    return split_key(key)[0] == "deck"


def find_station(state: LabState, key: str) -> StationState | None:
    """The station of a key; None if the key is of another kind or the station is unknown."""
    kind, name = split_key(key)
    return state.bench.stations.get(StationName(name)) if kind == "station" else None


def count_room(state: LabState, station: StationState) -> int:
    """The pieces of labware for which a station has room; for a hotel, the sum of all its shelves."""
    shelves = state.bench.shelves.get(station.spec.name, [])
    return sum(state.bench.stations[shelf].spec.capacity for shelf in shelves) or station.spec.capacity
