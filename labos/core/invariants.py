"""Invariants of the state. A batch of events that breaks one of them is never written."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any

import msgspec

from labos.core.actions import Action, ActionDiscovered, ActionRequested
from labos.core.bench import Labware, StationState
from labos.core.campaigns import Campaign
from labos.core.effects import list_arrivals, list_carried
from labos.core.ids import ActionId, CampaignId, LabwareId, ModuleName, RunId, StationName, workcell_of
from labos.core.modules import Module
from labos.core.registry import Event
from labos.core.runs import RunState
from labos.core.state import LabState


def find_broken(state: LabState) -> str:
    """The first broken invariant of the whole state, as a sentence; empty if there is none."""
    return _check(state, _find_all_subjects(state)) or _queue(state) or _check_indexes(state)


def find_broken_by(state: LabState, events: Iterable[Event]) -> str:
    """The first broken invariant among the subjects of these events. It is cheaper than ``find_broken``, and
    enough if all invariants held before."""
    known = _find_all_subjects(state)
    found: dict[str, dict[Any, Any]] = {}
    places: list[StationName] = []
    for event in events:
        for field, kind in _find_subjects(type(event)):
            name = getattr(event, field)
            if name in known[kind]:
                found.setdefault(kind, {})[name] = known[kind][name]
        if isinstance(event, ActionRequested | ActionDiscovered) and event.effects:
            places += list_arrivals(event.effects)
    if "labware" in found:
        places += [item.station for item in found["labware"].values()]
    for place in places:
        if place in known["station"]:
            found.setdefault("station", {})[place] = known["station"][place]
    return _check(state, found)


def _find_all_subjects(state: LabState) -> dict[str, dict[Any, Any]]:
    """The subjects with invariants, by kind and name."""
    return {
        "station": state.bench.stations,
        "labware": state.bench.labware,
        "module": state.modules.by_name,
        "action": state.actions.open,
        "run": state.runs.active,
        "campaign": state.campaigns.open,
    }


def _check(state: LabState, subjects: dict[str, dict[Any, Any]]) -> str:
    """The first broken invariant of these subjects; empty if there is none."""
    for kind, check in _CHECKS.items():
        if kind in subjects and (fault := check(state, subjects[kind])):
            return fault
    return ""


_KINDS = {
    "module": "module",
    "run": "run",
    "labware": "labware",
    "on": "labware",
    "action": "action",
    "campaign": "campaign",
    **dict.fromkeys(("station", "source", "target", "via", "stack", "where"), "station"),
}
"""The kinds of subjects that have invariants, by the fields of events that name them."""


@cache
def _find_subjects(kind: type[Event]) -> list[tuple[str, str]]:
    """The fields of an event that name subjects with invariants, each with the kind of the subject."""
    names = [f.name for f in msgspec.structs.fields(kind) if getattr(f.type, "__supertype__", f.type) is str]
    return [(name, _KINDS[name]) for name in names if name in _KINDS]


def _check_stations(state: LabState, stations: Mapping[StationName, StationState]) -> str:
    for name, station in stations.items():
        if station.expected < 0:
            return f"{name} expects {station.expected} arrivals"
        if len(station.lots) != len(station.stock):
            return f"{name} has {len(station.stock)} in stock and lots of {len(station.lots)}"
        if station.count - _count_seen_on_the_way(state, name, station) > station.spec.capacity:
            return f"{name} holds {station.count} of {station.spec.capacity}"
        for labware in station.labware:
            known = state.bench.labware.get(labware)
            if known is None or name not in (known.station, state.bench.find_planned_place(known.station)):
                return f"{labware} stands at {name} but knows nothing of it"
    return ""


def _count_seen_on_the_way(state: LabState, name: StationName, station: StationState) -> int:
    """The number of pieces that were seen here although the outcome of their motion is unknown, and that are
    expected here too: such a piece counts once."""
    moving = [state.bench.labware[item].moving for item in station.labware if item in state.bench.labware]
    ways = [list_arrivals(state.bench.reserved.get(ActionId(action), ())) for action in moving if action]
    return sum(name in way or name in map(state.bench.find_planned_place, way) for way in ways)


def _check_labware(state: LabState, labware: Mapping[LabwareId, Labware]) -> str:
    for name, item in labware.items():
        if item.station and item.maybe:
            return f"{name} is both at {item.station} and uncertain"
        if not item.station and not item.maybe and not item.on:
            return f"{name} is nowhere"
        if item.station and item.on:
            return f"{name} is both at {item.station} and on {item.on}"
        if item.on and (item.on not in state.bench.labware or state.bench.labware[item.on].lid != name):
            return f"{name} lies on {item.on}, which knows nothing of it"
        if item.lid and (item.lid not in state.bench.labware or state.bench.labware[item.lid].on != name):
            return f"{name} bears {item.lid}, which does not lie on it"
        if item.station and state.bench.stations[item.station].labware.count(name) != 1:
            return f"{name} is not exactly once at {item.station}"
        if item.moving and item.moving not in state.actions.open:
            return f"{name} is moved by {item.moving}, which is not open"
        if item.barcode and state.bench.barcodes.get(item.barcode) != name:
            return f"{name} is not found by its barcode {item.barcode}"
        if name not in state.bench.by_owner.get(item.owner, {}):
            return f"{name} is missing among what {item.owner or 'nobody'} owns"
    return ""


def _check_modules(state: LabState, modules: Mapping[ModuleName, Module]) -> str:
    for name, module in modules.items():
        if len({_find_group(state, a) for a, flight in module.in_flight.items() if flight.exclusive}) > 1:
            return f"{name} carries out two exclusive actions at once"
        for flying in module.in_flight:
            if flying not in state.actions.open:
                return f"{name} is busy with {flying}, which is not open"
    return ""


def _find_group(state: LabState, name: ActionId) -> tuple[ActionId, ...]:
    """All actions that a device carries out at once with this one, this one included."""
    action = state.actions.open.get(name)
    return (action.together if action is not None else ()) or (name,)


def _check_actions(state: LabState, actions: Mapping[ActionId, Action]) -> str:
    for action_id, action in actions.items():
        if action_id not in state.bench.reserved:
            return f"{action_id} is open but reserves nothing"
        if action.module not in state.modules.by_name:
            return f"{action_id} runs on {action.module}, which does not exist"
    return ""


def _check_runs(state: LabState, runs: Mapping[RunId, RunState]) -> str:
    for name, run in runs.items():
        if run.plan not in state.runs.plans:
            return f"run {name} has lost its plan"
        if len(run.steps) != len(state.runs.plan_of(run).steps):
            return f"run {name} counts its steps wrongly"
        if run.held or run.unapproved:
            return f"run {name} has begun before it was approved"
    return ""


def _queue(state: LabState) -> str:
    queued = sum(len(waiting) for waiting in state.runs.queue.values())
    if queued != len(state.runs.queued):
        return f"{len(state.runs.queued)} runs wait, but {queued} stand in the queue"
    return ""


def _check_indexes(state: LabState) -> str:
    """The first index that does not match the data; empty if all do."""
    bench, runs = state.bench, state.runs
    cells = (
        ("actions", state.actions.in_cell, {n: workcell_of(a.module) for n, a in state.actions.open.items()}),
        ("modules", state.modules.in_cell, {name: workcell_of(name) for name in state.modules.by_name}),
        ("stations", bench.in_cell, {name: workcell_of(name) for name in bench.stations}),
        ("runs", runs.in_cell, {name: runs.plan_of(run).workcell for name, run in runs.active.items()}),
    )
    for what, index, expected in cells:
        found = {name: cell for cell, names in index.items() for name in names}
        if found != expected:
            return f"the {what} by workcell are {found}, not {expected}"
    if {name for names in runs.windowed_in.values() for name in names} != runs.windowed.keys():
        return "the runs with windows by workcell are not those with windows"
    if bench.lost.keys() != {name for name, item in bench.labware.items() if item.maybe}:
        return f"{', '.join(bench.lost)} count as lost, others are"
    if runs.ending.keys() != {n for n, run in runs.active.items() if run.is_ending}:
        return f"{', '.join(runs.ending)} count as ending, others are"
    takes = Counter(e.stock for es in bench.reserved.values() for e in list_carried(es) if e.stock)
    for name, station in bench.stations.items():
        if station.taking != takes[name]:
            return f"{name} counts {station.taking} items being taken, not {takes[name]}"
    return ""


def _check_campaigns(state: LabState, campaigns: Mapping[CampaignId, Campaign]) -> str:
    for name, campaign in campaigns.items():
        ended = campaign.completed + campaign.failed + campaign.cancelled + campaign.refused
        if ended + len(campaign.runs) != campaign.next_row or campaign.next_row > campaign.rows:
            return f"{name} has submitted {campaign.next_row} of {campaign.rows} rows, but knows of others"
    return ""


_CHECKS: dict[str, Callable[[LabState, Any], str]] = {
    "station": _check_stations,
    "labware": _check_labware,
    "module": _check_modules,
    "action": _check_actions,
    "run": _check_runs,
    "campaign": _check_campaigns,
}
"""The check of the subjects of each kind."""
