"""Finds the arms that carry labware if a step names no module: one arm, or several with handovers between
them."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from labos.core.effects import Move
from labos.core.ids import ModuleName, StationName, local
from labos.core.model import ActionSpec, Description, TransferWay, Workcell
from labos.errors import SpecError
from labos.spec.about import describe_modules
from labos.spec.stations import Stations

TRANSFER = "transfer"
"""The action of a step without a module; it has the arguments ``source`` and ``target``."""

BETWEEN = ("nest", "exchange", "deck")
"""Kinds of stations where labware may be put down on its way."""


class Hop(NamedTuple):
    """One part of a way."""

    module: str
    action: str
    args: dict[str, Any]


class Carriers:
    """The ways for carrying labware between the stations of a workcell. They come from its file; if the file
    has none, they are the carrying actions of its modules, with their nominal duration as cost."""

    def __init__(self, workcell: Workcell, descriptions: Mapping[str, Description]) -> None:
        self.stations = Stations(workcell.name, workcell.stations)
        self._taught = {arm for station in workcell.stations for arm in station.reach}
        self.ways = workcell.transfers or tuple(_list_offered(workcell, descriptions))
        self._reach = {way.module: self._reach_of(way.module) for way in self.ways}

    def find_way(self, source: str, target: str) -> list[Hop]:
        """The way with the lowest cost from one station to another; with equal costs, the one with the fewest
        parts. Raises SpecError if there is no way, or for stations that this workcell does not have."""
        start, end = self.stations.find(source), self.stations.find(target)
        if start == end:
            message = f"The labware is moved from {local(start)} to the same place."
            raise SpecError(message, remedy="Name another target.")
        for place in (start, end):
            if not self.stations[place].transfers:
                raise SpecError(
                    f"{local(place)} takes part in no transfer (`transfers: false`).",
                    remedy="Name the `module:` that moves labware there.",
                )
        came: dict[StationName, tuple[StationName, TransferWay] | None] = {start: None}
        best = {start: (0.0, 0)}
        waiting: list[tuple[float, int, StationName]] = [(0.0, 0, start)]
        while waiting:
            cost, hops, here = heapq.heappop(waiting)
            if here == end:
                break
            if (cost, hops) > best[here]:
                continue
            for there, way in self._list_ways_onward(here, end):
                found = (cost + way.cost, hops + 1)
                if there not in best or found < best[there]:
                    best[there], came[there] = found, (here, way)
                    heapq.heappush(waiting, (*found, there))
        if end not in came:
            raise self._make_no_way_error(start, end)
        found_hops: list[Hop] = []
        while (step := came[end]) is not None:
            here, way = step
            args = {**way.args, way.source: local(here), way.target: local(end)}
            found_hops.append(Hop(local(way.module), way.action, args))
            end = here
        return found_hops[::-1]

    def _list_ways_onward(
        self, here: StationName, end: StationName
    ) -> Iterator[tuple[StationName, TransferWay]]:
        """The next stations on a way from a station to the end, each with the way to it."""
        near = set().union(*(places for places in self._reach.values() if here in places)) - {here}
        for there in sorted(near):
            spec = self.stations[there]
            if there != end and (spec.kind not in BETWEEN or not spec.transfers):
                continue
            way = self._find_cheapest_way(here, there)
            if way is not None:
                yield there, way

    def _find_cheapest_way(self, here: StationName, there: StationName) -> TransferWay | None:
        """The cheapest direct way from one station to another. Ways for exactly these two stations take
        precedence over ways for the first one. These take precedence over ways for the second one, and these
        over all others."""
        ranked: dict[tuple[bool, bool], list[TransferWay]] = {}
        for way in self.ways:
            if here in (way.from_stations or (here,)) and there in (way.to_stations or (there,)):
                rank = (bool(way.from_stations), bool(way.to_stations))
                ranked.setdefault(rank, []).append(way)
        if not ranked:
            return None
        able = [way for way in ranked[max(ranked)] if {here, there} <= self._reach[way.module]]
        return min(able, key=lambda way: way.cost, default=None)

    def _make_no_way_error(self, start: StationName, end: StationName) -> SpecError:
        reaching = sorted({local(module) for module, places in self._reach.items() if end in places})
        return SpecError(
            f"No module moves labware from {local(start)} to {local(end)}, which "
            f"{', '.join(reaching) or 'nobody'} can reach.",
            remedy="Teach one arm both stations, or two arms a common station between them.",
        )

    def _reach_of(self, module: ModuleName) -> frozenset[StationName]:
        """The stations for which a module was taught poses, and its own stations; all stations if it has
        neither."""
        places = [s for s in self.stations.by_name.values() if s.kind != "gripper" and not s.hotel]
        own = frozenset(s.name for s in places if s.module == module)
        if module not in self._taught and not own:
            return frozenset(s.name for s in places)
        return own | {s.name for s in places if module in s.reach}


def _list_offered(workcell: Workcell, descriptions: Mapping[str, Description]) -> Iterable[TransferWay]:
    """The ways that the modules of a workcell offer themselves."""
    for name, known in describe_modules(workcell, descriptions).items():
        for action in known.actions:
            ends = _find_end_arguments(action)
            if ends is not None:
                yield TransferWay(name, action.name, *ends, cost=action.duration_s)


def _find_end_arguments(action: ActionSpec) -> tuple[str, str] | None:
    """The two arguments between which an action carries labware, if it needs no others."""
    for effect in action.effects:
        if type(effect) is not Move:
            continue
        ends = effect.source.strip("{}"), effect.target.strip("{}")
        places = {arg.name for arg in action.args if arg.type == "station"}
        needed = {arg.name for arg in action.args if arg.required}
        if set(ends) <= places and needed <= set(ends) and ends[0] != ends[1]:
            return ends
    return None
