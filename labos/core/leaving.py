"""The ``on_cancel`` steps of a cancelled run: which of them its present state needs.

The steps are checked in their order. A step that takes or needs labware is needed if labware of the run
stands there at that time. Any other step is needed if labware of the run stands on its module, or if the run
left a door or lid of the module away from rest. Steps without any effect are left out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import msgspec

from labos.core.algebra import carry, compute_settings_after, list_away_from_rest
from labos.core.branches import sort_steps
from labos.core.effects import Needs, Requires, Sets, list_carried
from labos.core.ids import ModuleName, Owner, StationName, run_owner
from labos.core.model import ON_CANCEL, Plan, PlanStep
from labos.core.runs import RunState, RunStatus
from labos.core.state import LabState


class BenchOfRun(msgspec.Struct):
    """The parts of the bench that concern one run. These are the amount of its labware at each station, the
    modules of the stations, and the present and rest values of doors and lids. ``BenchOfRun`` also has the
    modules whose doors or lids the run left away from rest."""

    standing: Counter[StationName]
    owner: Mapping[StationName, ModuleName]
    doors: dict[ModuleName, dict[str, Any]]
    rests: Mapping[ModuleName, Mapping[str, Any]]
    left: set[ModuleName]

    def lift(self, place: StationName) -> None:
        self.standing[place] -= 1

    def put(self, place: StationName) -> None:
        self.standing[place] += 1


def list_steps_out(plan: Plan) -> list[int]:
    """The steps under ``on_cancel``."""
    return [index for index, step in enumerate(plan.steps) if step.part == ON_CANCEL]


def will_leave(plan: Plan, run: RunState) -> bool:
    """Whether a cancelled run carries out ``on_cancel`` steps as soon as nothing of it is in flight."""
    return run.status == RunStatus.CANCELLING and not run.why and not run.stay and bool(list_steps_out(plan))


def find_way_out(plan: Plan, scene: BenchOfRun) -> tuple[int, ...]:
    """The needed ``on_cancel`` steps for a scene. The scene is changed to the state after them."""
    found = []
    for index in sort_steps(plan, list_steps_out(plan)):
        step = plan.steps[index]
        if is_needed(step, scene):
            found.append(index)
            carry_out(step, scene)
    return tuple(found)


def is_needed(step: PlanStep, scene: BenchOfRun) -> bool:
    """Whether an ``on_cancel`` step has an effect on a scene."""
    for what in list_carried(step.effects):
        if what.stands:
            return all(scene.standing[place] > 0 for place in what.stands)
    needs = [effect for effect in step.effects if isinstance(effect, Needs)]
    here = any(scene.owner.get(place) == step.module for place, number in scene.standing.items() if number)
    if needs:
        named = [effect.station for effect in needs if effect.station]
        return all(scene.standing[place] > 0 for place in named) if named else here
    if not here and step.module not in scene.left:
        return False
    doors = compute_settings_after(step.effects).variables
    now = scene.doors.get(step.module, {})
    does_more = any(
        not isinstance(effect, Requires) and not (isinstance(effect, Sets) and effect.of == "module")
        for effect in step.effects
    )
    return does_more or not doors or any(now.get(name) != value for name, value in doors.items())


def carry_out(step: PlanStep, scene: BenchOfRun) -> None:
    """Change a scene to the state after a step."""
    for what in list_carried(step.effects):
        carry(scene, what)
    doors = compute_settings_after(step.effects).variables
    if doors:
        now = scene.doors.setdefault(step.module, {})
        now.update(doors)
        away = list_away_from_rest(now, scene.rests.get(step.module, {}))
        (scene.left.add if away else scene.left.discard)(step.module)


def find_bench_of_run(state: LabState, run: RunState) -> BenchOfRun:
    """The parts of the bench that concern a run."""
    scene = look_at(state, state.runs.plan_of(run).workcell, run_owner(run.id))
    scene.left = {
        name
        for name, module in state.modules.list_in_cell(state.runs.plan_of(run).workcell)
        if any(left.by == run.id for left in module.list_away_from_rest().values())
    }
    return scene


def look_at(state: LabState, cell: str, owner: Owner) -> BenchOfRun:
    """The parts of the bench of a workcell that concern an owner's labware."""
    places = [item.station for item in state.bench.list_owned(owner) if item.station]
    modules = state.modules.list_in_cell(cell)
    return BenchOfRun(
        Counter([name for place in places for name in {place, state.bench.find_planned_place(place)}]),
        {name: state.bench.stations[name].spec.module for name in state.bench.in_cell.get(cell, ())},
        {name: module.values for name, module in modules},
        {name: module.spec.rest for name, module in modules},
        set(),
    )


def has_lost_labware(state: LabState, run: RunState) -> bool:
    """Whether the place of some of a run's labware is unknown."""
    return any(item.maybe for item in state.bench.list_owned(run_owner(run.id)))
