"""The ``on_cancel`` steps that a cancelled run has left, as motions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from labos.core.branches import sort_steps
from labos.core.ids import RunId, StationName, run_owner
from labos.core.modules import Module
from labos.core.runs import IN_FLIGHT, PENDING, RunState
from labos.core.state import LabState
from labos.planning.held import door_key, setpoint_key
from labos.planning.paths import CellRules, Motion, RunOnBench, list_motions_of_steps


def find_way_out(state: LabState, run: RunState, rules: CellRules) -> tuple[Motion, ...]:
    """The motions of the steps that a leaving run has not started, and of its end."""
    plan = state.runs.plan_of(run)
    left = [index for index, step in enumerate(run.steps) if step.status in (PENDING, IN_FLIGHT)]
    before = _list_left(state, run, rules.claims)
    motions = list_motions_of_steps(plan, sort_steps(plan, left), rules, before)
    return tuple(
        motion
        for motion in motions
        if not isinstance(motion.step, int) or run.steps[motion.step].status == PENDING
    )


def _list_left(state: LabState, run: RunState, claims: Mapping[StationName, str]) -> RunOnBench:
    """What a run has on the bench now: labware, claims, loans, doors away from rest, and setpoints."""
    stand = RunOnBench()
    for item in state.bench.list_owned(run_owner(run.id)):
        place = state.bench.find_planned_place(item.station)
        stand.own[place] += 1
        stand.claims[claims.get(place, "")] += 1
        if item.lender:
            stand.lent[place] = True
    for name, module in state.modules.list_in_cell(state.runs.plan_of(run).workcell):
        doors = _find_left(module, run.id)
        if doors:
            stand.doors[name] = doors
            stand.held[door_key(name)] = True
        for setpoint, held in module.setpoints.items():
            if run.id in held.holders:
                stand.held[setpoint_key(name, setpoint)] = True
    return stand


def _find_left(module: Module, run: RunId) -> dict[str, Any]:
    """The values of the doors and lids that a run has left away from their rest positions."""
    left = module.list_away_from_rest().items()
    return {variable: stands.value for variable, stands in left if stands.by == run}
