"""Whether what is there is enough for all runs, or some will find too little."""

from __future__ import annotations

from collections.abc import Iterable

from labos.core.effects import list_carried
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.planning.forecast import is_pending


def are_enough(state: LabState, runs: Iterable[RunState]) -> bool:
    """Whether the supplies, the labware in stacks and the room in waste places are enough for these runs. A
    stack counts only if its contents are known."""
    supplies: dict[tuple[str, str], float] = {}
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
    for (where, resource), amount in supplies.items():
        level = state.resources.levels.get(f"{where}:{resource}")
        if level is not None and amount > level.level:
            return False
    for place, station in state.bench.stations.items():
        taken, brought = places.get((place, True), 0), places.get((place, False), 0)
        if station.spec.kind == "stack" and station.known and taken > len(station.stock):
            return False
        if station.spec.kind == "waste" and brought > station.spec.capacity - station.count:
            return False
    return True
