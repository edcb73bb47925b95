"""Finds who carries labware where a step names no module: one arm, or several, each to where the next one
reaches."""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from typing import NamedTuple

from labos.core.effects import Move
from labos.core.ids import ModuleName, StationName, local
from labos.core.model import ActionSpec, Description, Workcell
from labos.errors import SpecError
from labos.spec.about import described
from labos.spec.stations import Stations

TRANSFER = "transfer"
"""The action of a step that names no module, with the arguments ``source`` and ``target``."""

BETWEEN = ("nest", "exchange", "deck")
"""Kinds of station where labware may be put down on its way."""


class Carrier(NamedTuple):
    """An action that carries labware, its arguments for where from and where to, and where it reaches."""

    module: str
    action: str
    source: str
    target: str
    duration_s: float
    reach: frozenset[StationName]


class Hop(NamedTuple):
    """A step on the way."""

    module: str
    action: str
    args: dict[str, str]


class Carriers:
    """The actions of a workcell that carry labware from one station to another."""

    def __init__(self, workcell: Workcell, descriptions: Mapping[str, Description]) -> None:
        self.stations = Stations(workcell.name, workcell.stations)
        self._taught = {arm for station in workcell.stations for arm in station.reach}
        self.carriers = [
            Carrier(local(module.name), action.name, *ends, action.duration_s, self._reach(module.name))
            for module in workcell.modules
            if (known := described(module, descriptions)) is not None
            for action in known.actions
            if (ends := _ends(action)) is not None
        ]

    def way(self, source: str, target: str) -> list[Hop]:
        """The steps from one station to another that take the least time. Raises SpecError if there is no
        way, or for stations that this workcell does not have."""
        start, end = self.stations.find(source), self.stations.find(target)
        if start == end:
            message = f"The labware is moved from {local(start)} to where it stands."
            raise SpecError(message, remedy="Name another target.")
        came: dict[StationName, tuple[StationName, Carrier] | None] = {start: None}
        best = {start: 0.0}
        waiting: list[tuple[float, int, StationName]] = [(0.0, 0, start)]
        while waiting:
            cost, hops, here = heapq.heappop(waiting)
            if here == end:
                break
            if cost > best[here]:
                continue
            for carrier in self.carriers:
                for there in sorted(carrier.reach) if here in carrier.reach else ():
                    if there != end and self.stations[there].kind not in BETWEEN:
                        continue
                    if cost + carrier.duration_s < best.get(there, float("inf")):
                        best[there], came[there] = cost + carrier.duration_s, (here, carrier)
                        heapq.heappush(waiting, (best[there], hops + 1, there))
        if end not in came:
            reaching = ", ".join(sorted({c.module for c in self.carriers if end in c.reach})) or "nobody"
            raise SpecError(
                f"Nobody carries labware from {local(start)} to {local(end)}, which {reaching} can reach.",
                remedy="Teach an arm both of them, or a station from which another one goes on.",
            )
        found: list[Hop] = []
        while (step := came[end]) is not None:
            here, carrier = step
            args = {carrier.source: local(here), carrier.target: local(end)}
            found.append(Hop(carrier.module, carrier.action, args))
            end = here
        return found[::-1]

    def _reach(self, module: ModuleName) -> frozenset[StationName]:
        """The stations that a module was taught, and its own; all of them if nothing is known of it."""
        places = [s for s in self.stations.by_name.values() if s.kind != "gripper" and not s.hotel]
        own = frozenset(s.name for s in places if s.module == module)
        if module not in self._taught and not own:
            return frozenset(s.name for s in places)
        return own | {s.name for s in places if module in s.reach}


def _ends(action: ActionSpec) -> tuple[str, str] | None:
    """The arguments between which an action carries labware, if it needs no others."""
    for effect in action.effects:
        if type(effect) is not Move:
            continue
        ends = effect.source.strip("{}"), effect.target.strip("{}")
        places = {arg.name for arg in action.args if arg.type == "station"}
        needed = {arg.name for arg in action.args if arg.required}
        if set(ends) <= places and needed <= set(ends) and ends[0] != ends[1]:
            return ends
    return None
