"""Whether the supplies are enough for all runs, or too low for some of them."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf

from labos.core.effects import list_carried
from labos.core.ids import ModuleName
from labos.core.rules import find_spare
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.planning.forecast import is_pending

SupplyNeeds = tuple[tuple[tuple[ModuleName, str], float], ...]
"""The amounts that a run uses up in all: ((module, resource), amount)."""


def are_enough(state: LabState, runs: Iterable[RunState]) -> bool:
    """Whether the supplies, the labware in stacks and the room in waste places are enough for these runs. A
    stack counts only if its contents are known."""
    supplies: dict[tuple[ModuleName, str], float] = {}
    places: dict[tuple[str, bool], int] = {}
    for run in runs:
        for index, module, resource, amount in state.runs.plans[run.plan].uses_up:
            if is_pending(run, index):
                supplies[module, resource] = supplies.get((module, resource), 0.0) + amount
        for index, step in enumerate(state.runs.plan_of(run).steps):
            if is_pending(run, index):
                for what in list_carried(step.effects):
                    if what.stock:
                        places[what.stock, True] = places.get((what.stock, True), 0) + 1
                    if what.filled:
                        places[what.filled, False] = places.get((what.filled, False), 0) + 1
    for supply, amount in supplies.items():
        left = state.resources.find_left(*supply)
        if left is not None and amount > left:
            return False
    for place, station in state.bench.stations.items():
        taken, brought = places.get((place, True), 0), places.get((place, False), 0)
        if station.spec.kind == "stack" and station.known and taken > len(station.stock):
            return False
        if station.spec.kind == "waste" and brought > station.spec.capacity - station.count:
            return False
    return True


class Spares:
    """What an admitted run finds of each supply. Call ``forget`` after each event."""

    def __init__(self) -> None:
        self._known: dict[tuple[ModuleName, str], tuple[float, float]] = {}

    def forget(self) -> None:
        self._known.clear()

    def are_enough(self, state: LabState, needs: SupplyNeeds) -> bool:
        """Whether the supplies allow the start of a run that uses up these amounts. Also False if packs may
        be too old for it."""
        for supply, amount in needs:
            known = self._known.get(supply)
            if known is None:
                level = state.resources.find(*supply)
                may_be_old = level is not None and any(lot.expires for lot in level.lots)
                known = self._known[supply] = (-inf, inf) if may_be_old else find_spare(state, *supply)
            if known[0] < min(amount, known[1]):
                return False
        return True
