"""What must always hold. A batch of events that breaks one of these is never written."""

from __future__ import annotations

from labos.core.state import LabState


def broken(state: LabState) -> str:
    """The first invariant that does not hold, as a sentence; empty if all do."""
    return _stations(state) or _labware(state) or _actions(state) or _runs(state)


def _stations(state: LabState) -> str:
    for name, station in state.bench.stations.items():
        if station.expected < 0:
            return f"{name} expects {station.expected} arrivals"
        if station.count > station.spec.capacity:
            return f"{name} holds {station.count} of {station.spec.capacity}"
        for labware in station.labware:
            known = state.bench.labware.get(labware)
            if known is None or known.station != name:
                return f"{labware} stands at {name} but knows nothing of it"
    return ""


def _labware(state: LabState) -> str:
    for name, item in state.bench.labware.items():
        if item.station and item.maybe:
            return f"{name} is both at {item.station} and uncertain"
        if not item.station and not item.maybe:
            return f"{name} is nowhere"
        if item.station and state.bench.stations[item.station].labware.count(name) != 1:
            return f"{name} is not exactly once at {item.station}"
        if item.moving and item.moving not in state.actions.open:
            return f"{name} is moved by {item.moving}, which is not open"
        if name not in state.bench.by_owner.get(item.owner, {}):
            return f"{name} is missing among what {item.owner or 'nobody'} owns"
    return ""


def _actions(state: LabState) -> str:
    for name, module in state.modules.by_name.items():
        if sum(module.in_flight.values()) > 1:
            return f"{name} carries out two exclusive actions at once"
        for flying in module.in_flight:
            if flying not in state.actions.open:
                return f"{name} is busy with {flying}, which is not open"
    for action_id, action in state.actions.open.items():
        if action_id not in state.bench.reserved:
            return f"{action_id} is open but reserves nothing"
        if action.module not in state.modules.by_name:
            return f"{action_id} runs on {action.module}, which does not exist"
    return ""


def _runs(state: LabState) -> str:
    for name, run in state.runs.active.items():
        if run.plan not in state.runs.plans:
            return f"run {name} has lost its plan"
        if len(run.steps) != len(state.runs.plan_of(run).steps):
            return f"run {name} counts its steps wrongly"
    queued = sum(len(waiting) for waiting in state.runs.queue.values())
    if queued != len(state.runs.queued):
        return f"{len(state.runs.queued)} runs wait, but {queued} stand in the queue"
    return ""
