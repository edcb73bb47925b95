"""Zones: parts of the bench in which only one arm may be at a time.

An arm is in a zone while an action of it carries labware into or out of a station of the zone. A module with
a zone of its own is in it during all its actions. An arm that failed in a zone is assumed to be still there
until it is idle again.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable

from labos.core.actions import ActionStatus
from labos.core.effects import AnyEffect, Carrying, Needs
from labos.core.ids import ModuleName, StationName, workcell_of
from labos.core.modules import Module, ModuleStatus
from labos.core.state import LabState


def find_zones(state: LabState, module: ModuleName, effects: Collection[AnyEffect]) -> tuple[str, ...]:
    """The zones in which a module is during an exclusive action with these effects."""
    known, stations = state.modules.by_name.get(module), state.bench.stations
    own = known.spec.zone if known is not None else ""
    if not own and not effects:
        return ()
    return find_zones_reached(
        own, effects, lambda place: stations[place].spec.zone if place in stations else ""
    )


def find_zones_reached(
    own: str, effects: Iterable[AnyEffect], zone_at: Callable[[StationName], str]
) -> tuple[str, ...]:
    """The zones of an action of a module. ``own`` is the module's own zone (may be empty); ``zone_at``
    returns the zone of a station."""
    zones = dict.fromkeys([own, *map(zone_at, _find_reached(effects))])
    zones.pop("", None)
    return tuple(zones)


def _find_reached(effects: Iterable[AnyEffect]) -> list[StationName]:
    """The stations into which an action reaches."""
    places: list[StationName] = []
    for effect in effects:
        if isinstance(effect, Carrying):
            places += effect.entered
        elif isinstance(effect, Needs) and effect.station:
            places.append(effect.station)  # an arm that lifts a lid there does so too
    return places


def find_other_at_work(state: LabState, zone: str, besides: ModuleName) -> ModuleName:
    """Another module whose action in flight is in a zone; empty if there is none."""
    for action in state.actions.list_in_cell(workcell_of(besides)):
        other = action.exclusive and action.module != besides
        if other and zone in find_zones(state, action.module, action.effects):
            return action.module
    return ModuleName("")


def find_stopped_module(state: LabState, zone: str, besides: ModuleName) -> ModuleName:
    """Another module that failed in a zone and may still be in it."""
    for name, module in state.modules.list_in_cell(workcell_of(besides)):
        in_doubt = module.reached and module.status != ModuleStatus.IDLE
        if name != besides and in_doubt and zone in _list_left_in(state, module):
            return name
    return ModuleName("")


def find_barred_zones(state: LabState, cell: str) -> dict[str, ModuleName]:
    """Zones of a workcell that no other module can use before a person or a device has acted, and the module
    in each of them."""
    found: dict[str, ModuleName] = {}
    for name in state.modules.in_cell.get(cell, ()):
        module = state.modules.by_name[name]
        if module.reached and module.status in (ModuleStatus.ERROR, ModuleStatus.GONE):
            found.update(dict.fromkeys(_list_left_in(state, module), name))
    for action in state.actions.list_in_cell(cell):
        if action.status == ActionStatus.UNKNOWN and action.exclusive:
            found.update(dict.fromkeys(find_zones(state, action.module, action.effects), action.module))
    return found


def _list_left_in(state: LabState, module: Module) -> list[str]:
    known = state.bench.stations
    zones = [known[place].spec.zone for place in module.reached if place in known]
    return [zone for zone in [*zones, module.spec.zone] if zone]
