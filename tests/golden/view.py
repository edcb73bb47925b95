"""The canonical view of a lab: what stands where, what runs, what is left, what is asked.

Plain JSON that says the same whatever the state looks like in memory. Two versions fold a log alike if
their views are equal; a version that keeps its records in another way changes this file, never the noted
views.
"""

from __future__ import annotations

from typing import Any

import msgspec

from labos.core.bench import Bench, Labware, StationState
from labos.core.campaigns import Campaign
from labos.core.interventions import Intervention
from labos.core.modules import Module
from labos.core.runs import RunState, StepState, find_results, make_first_states
from labos.core.state import LabState


def lab_view(state: LabState) -> dict[str, Any]:
    """The view of a state, as JSON values."""
    runs = [*state.runs.active.values(), *state.runs.queued.values()]
    view = {
        "position": state.position,
        "lab": {"id": state.lab.id, "epoch": state.lab.epoch, "paused": sorted(state.lab.paused)},
        "places": {name: _place(state.bench, station) for name, station in state.bench.stations.items()},
        "labware": {name: _labware(item) for name, item in state.bench.labware.items()},
        "modules": {name: _module(module) for name, module in state.modules.by_name.items()},
        "runs": {run.id: _run(state, run) for run in runs},
        "actions": {
            action.id: {
                "run": action.run,
                "step": action.step,
                "module": action.module,
                "name": action.name,
                "attempt": action.attempt,
                "status": str(action.status),
            }
            for action in state.actions.open.values()
        },
        "resources": {
            f"{module} {resource}": _level(state, module, resource)
            for module, spec in ((name, known.spec) for name, known in state.modules.by_name.items())
            for resource in spec.levels
            if state.resources.find(module, resource) is not None
        },
        "questions": {name: _question(asked) for name, asked in state.interventions.open.items()},
        "experiments": {
            name: {"user": found.user, "status": str(found.status), "runs": sorted(found.runs)}
            for name, found in state.experiments.open.items()
        },
        "campaigns": {name: _campaign(found) for name, found in state.campaigns.open.items()},
        "next": {"labware": state.bench.next_id, "question": state.interventions.next_id},
    }
    plain: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(view))
    return plain


def _place(bench: Bench, station: StationState) -> dict[str, Any]:
    return {
        "known": station.known,
        "labware": station.labware,
        "stock": station.stock,
        "lots": station.lots,
        "expected": station.expected,
        "taking": station.taking,
        "level": station.level,
        "maybe": bench.uncertain_at.get(station.spec.name, 0),
    }


def _labware(item: Labware) -> dict[str, Any]:
    return {
        "type": item.type,
        "station": item.station,
        "maybe": item.maybe,
        "owner": item.owner,
        "moving": item.moving,
        "lid": item.lid,
        "on": item.on,
        "barcode": item.barcode,
        "samples": item.samples,
        "volumes_ul": item.volumes_ul,
        "variables": item.variables,
    }


def _module(module: Module) -> dict[str, Any]:
    return {
        "status": str(module.status),
        "error": module.error,
        "out_of_service": module.out_of_service,
        "stopped_at": module.stopped_at,
        "doubted": module.doubted,
        "reached": module.reached,
        "variables": {name: [known.value, known.by] for name, known in module.variables.items()},
        "setpoints": {name: [held.value, list(held.holders)] for name, held in module.setpoints.items()},
        "in_flight": {name: flight.exclusive for name, flight in module.in_flight.items()},
        "taught": {n: [by[""].pose, by[""].proven] for n, by in module.taught.items() if "" in by},
        "failures": [failure.what for failure in module.failures],
    }


def _run(state: LabState, run: RunState) -> dict[str, Any]:
    plan = state.runs.plan_of(run)
    steps = run.steps or make_first_states(plan)
    results = find_results(plan, run)
    return {
        "workflow": run.workflow,
        "user": run.user,
        "experiment": run.experiment,
        "campaign": run.campaign,
        "status": str(run.status),
        "paused": run.paused,
        "why": run.why,
        "started_at": run.started_at,
        "steps": [_step(step, index in results) for index, step in enumerate(steps)],
        "holds": [hold.module for hold in plan.holds if run.id in state.runs.list_holders(hold.module)],
    }


def _step(step: StepState, read: bool) -> dict[str, Any]:
    """What is known of a step; what nothing is to be said of is left out. ``read``: later steps read it."""
    said: dict[str, Any] = {"status": step.status}
    if step.ended_at is not None:
        said["ended_at"] = step.ended_at
    if read:
        said["result"] = step.result
    if step.breached:
        said["breached"] = True
    if step.retries:
        said["retries"], said["retried_at"] = step.retries, step.retried_at
    if step.trouble is not None:
        said["trouble"] = step.trouble
    return said


def _level(state: LabState, module: Any, resource: str) -> list[Any]:
    level = state.resources.find(module, resource)
    assert level is not None
    return [level.level, level.capacity, [[lot.name, lot.left, lot.expires] for lot in level.lots]]


def _question(asked: Intervention) -> dict[str, Any]:
    return {
        "kind": asked.kind,
        "subject": asked.subject,
        "text": asked.text,
        "choices": [[choice.name, choice.consequence] for choice in asked.choices],
        "run": asked.run,
        "module": asked.module,
        "labware": asked.labware,
        "motions": asked.motions,
        "requested_at": asked.requested_at,
        "due_at": asked.due_at,
        "overdue": asked.overdue,
    }


def _campaign(found: Campaign) -> dict[str, Any]:
    return {
        "status": str(found.status),
        "next_row": found.next_row,
        "runs": found.runs,
        "spent_ns": found.spent_ns,
    }
