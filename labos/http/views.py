"""The lab's state as plain data, for JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import msgspec
import structlog

from labos.core.actions import Action
from labos.core.bench import Station
from labos.core.decide.access import in_motion, perhaps_in_motion
from labos.core.ids import ModuleName, RunId, local
from labos.core.interventions import Intervention
from labos.core.model import PlanStep
from labos.core.modules import Module
from labos.core.runs import DONE, FAILED, IN_FLIGHT, UNKNOWN, RunState, at_first, in_play
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.planning.obstacle import explained
from labos.runtime.kernel import Kernel
from labos.services.interventions import whereabouts

STEP_STATES = ("pending", "in flight", "done", "failed", "unknown", "skipped")
QUEUED_SHOWN = 100

_log = structlog.get_logger(__name__)


class NodeProcess(Protocol):
    """What a supervisor says of a node's process."""

    state: str
    pid: int
    starts: int
    why: str


class Supervised(Protocol):
    @property
    def nodes(self) -> Mapping[str, Any]: ...


def lab_view(
    kernel: Kernel,
    *,
    simulated: bool,
    rejected: Mapping[str, str],
    supervised: Mapping[str, Any],
    waits: bool = True,
) -> dict[str, Any]:
    """Everything that is alive in the lab."""
    state, now = kernel.state, kernel.clock.now_ns()
    queued = list(state.runs.queued.values())
    runs = [*state.runs.active.values(), *queued[:QUEUED_SHOWN]]
    flying = {(action.run, action.step): action for action in state.actions.open.values()}
    return {
        "lab": {
            "id": state.lab.id,
            "name": state.lab.name,
            "pace": state.lab.pace,
            "epoch": state.lab.epoch,
            "simulated": simulated,
            "workcells": dict(state.lab.workcells),
            "access": {
                cell: {
                    "by": access.by,
                    "why": access.why,
                    "granted": access.granted,
                    "moving": in_motion(state, cell),
                    "perhaps_moving": perhaps_in_motion(state, cell),
                }
                for cell, access in state.lab.access.items()
            },
        },
        "position": state.position,
        "now": now,
        "modules": [
            module_view(name, module, state, rejected, supervised)
            for name, module in state.modules.by_name.items()
        ],
        "stations": [station_view(name, station) for name, station in state.bench.stations.items()],
        "labware": [
            {
                "id": item.id,
                "type": item.type,
                "station": local(item.station),
                "maybe": [local(place) for place in item.maybe],
                "lid": item.lid,
                "on": item.on,
                "owner": item.owner,
                "moving": item.moving,
                "variables": item.variables,
                "barcode": item.barcode,
            }
            for item in state.bench.labware.values()
        ],
        "runs": [run_view(kernel, run, now, flying, waits=waits) for run in runs],
        "queued": len(queued),
        "interventions": [question_view(state, asked) for asked in state.interventions.open.values()],
        "experiments": [
            {
                "id": item.id,
                "name": item.name,
                "user": item.user,
                "status": item.status,
                "runs": list(item.runs),
                "started_at": item.started_at,
            }
            for item in state.campaigns.experiments.values()
        ],
        "resources": {
            key: {"level": level.level, "capacity": level.capacity}
            for key, level in state.resources.levels.items()
        },
    }


def module_view(
    name: str, module: Module, state: LabState, rejected: Mapping[str, str], supervised: Mapping[str, Any]
) -> dict[str, Any]:
    process = supervised.get(name)
    doing = [state.actions.open[action] for action in module.in_flight if action in state.actions.open]
    problem = module.out_of_service or rejected.get(name, "") or module.error
    if process is not None and process.state == "quarantined":
        problem = f"given up after {process.failures} failures: {process.why}"
    return {
        "name": name,
        "driver": module.spec.driver,
        "model": module.spec.model,
        "status": "BUSY" if module.status == "IDLE" and module.busy else module.status,
        "problem": problem,
        "out_of_service": bool(module.out_of_service),
        "back_at": state.modules.back_at.get(ModuleName(name), 0),
        "simulated": module.simulated,
        "variables": module.variables,
        "doing": [
            {"action": a.name, "run": a.run, "since": a.requested_at, "status": a.status} for a in doing
        ],
        "process": None
        if process is None
        else {"state": process.state, "pid": process.pid, "starts": process.starts},
    }


def question_view(state: LabState, question: Intervention) -> dict[str, Any]:
    """What the lab asks a person, and what may be answered."""
    return {
        "id": question.id,
        "kind": question.kind,
        "text": question.text,
        "now": whereabouts(state, question),
        "choices": [msgspec.to_builtins(choice) for choice in question.choices],
        "run": question.run,
        "module": local(question.module),
        "requested_at": question.requested_at,
        "due_at": question.due_at,
        "overdue": question.overdue,
    }


def station_view(name: str, station: Station) -> dict[str, Any]:
    return {
        "name": name,
        "kind": station.spec.kind,
        "capacity": station.spec.capacity,
        "known": station.known,
        "labware": list(station.labware),
        "stock": len(station.stock),
        "level": station.level,
        "hotel": station.spec.hotel,
    }


def run_view(
    kernel: Kernel, run: RunState, now: int, flying: Mapping[tuple[RunId, int], Action], *, waits: bool
) -> dict[str, Any]:
    """A run that is alive: how far it is, what it does, and why it does not go on. ``flying`` are the open
    actions by run and step."""
    state = kernel.state
    plan = state.runs.plan_of(run)
    steps = run.steps or at_first(plan)
    return {
        "id": run.id,
        "workflow": run.workflow,
        "workcell": plan.workcell,
        "user": run.user,
        "experiment": run.experiment,
        "priority": run.priority,
        "status": "paused" if run.paused else run.status,
        "closing": run.closing,
        "submitted_at": run.submitted_at,
        "started_at": run.started_at,
        "steps": in_play(plan, steps),
        "done": sum(step == DONE for step in steps),
        "failed": sum(step == FAILED for step in steps),
        "doing": [
            {
                "step": index,
                "key": plan.steps[index].key,
                "module": local(plan.steps[index].module),
                "action": plan.steps[index].action,
                "state": STEP_STATES[step],
                **_times(state, flying.get((run.id, index)), plan.steps[index], now),
            }
            for index, step in enumerate(steps)
            if step in (IN_FLIGHT, UNKNOWN)
        ],
        "waits": waits_view(kernel, run, now) if waits else [],
    }


def _times(state: LabState, action: Action | None, step: PlanStep, now: int) -> dict[str, Any]:
    """Since when a step is under way (UTC ns), and how long it still takes (lab seconds) if it takes as long
    as it should."""
    if action is None:
        return {"since": 0, "left_s": None}
    gone_s = (now - action.requested_at) / 1e9 * state.lab.pace
    return {"since": action.requested_at, "left_s": round(max(step.duration_s - gone_s, 0.0), 1)}


def waits_view(kernel: Kernel, run: RunState, now: int) -> list[dict[str, Any]]:
    """Why a run does not go on, in one sentence for each step whose turn it is."""
    plan = kernel.state.runs.plan_of(run)

    def view(step: int, wait: Wait) -> dict[str, Any]:
        return {
            "step": step,
            "key": plan.steps[step].key,
            "code": wait.code,
            "why": explained(kernel.scheduler.safety, kernel.state, run, wait),
            "blocked": wait.blocked,
        }

    if kernel.suspended:
        return [_unplanned(f"Nothing is started, since planning fails: {kernel.suspended}")]
    try:
        return [view(step, wait) for step, wait in kernel.scheduler.waits(kernel.state, run, now)]
    except Exception as error:  # the rest of the view is worth having
        _log.exception("wait_not_explained", run=run.id)
        return [_unplanned(f"LabOS cannot say what it waits for: {error!r}. This is a fault of LabOS.")]


def _unplanned(why: str) -> dict[str, Any]:
    return {"step": 0, "key": "", "code": "planning_failed", "why": why, "blocked": True}
