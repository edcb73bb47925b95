"""What one step at a time may have."""

from __future__ import annotations

from labos.core.effects import list_carried
from labos.core.model import PlanStep
from labos.core.state import LabState
from labos.core.waits import module_key, station_key, zone_key
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
