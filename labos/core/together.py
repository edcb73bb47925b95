"""Actions that a device carries out at once for the labware of several runs, as in a centrifuge.

Each run has its own action. The actions are requested in one commit, and the device carries them out at once.
All labware in the device takes part, even if its run is not ready. So no run starts before all runs with
labware in the device can start with the same arguments.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

from labos.core import reasons
from labos.core.ids import (
    LabwareId,
    ModuleName,
    RunId,
    StationName,
    find_owning_run,
    module_key,
    run_key,
    run_owner,
    station_key,
)
from labos.core.model import PlanStep, Together
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.core.waits import Wait


def find_together(state: LabState, step: PlanStep) -> Together | None:
    """How the device of a step works for several runs at once; None if it does not."""
    module = state.modules.by_name.get(step.module)
    together = module.spec.together if module is not None else None
    return together if together is not None and step.action in together.actions else None


def list_inside(state: LabState, module: ModuleName) -> Iterator[tuple[RunId, LabwareId, StationName]]:
    """Labware of runs that stands, or may stand, in a module."""
    bench = state.bench
    for place in bench.by_module.get(module, ()):
        for name in bench.stations[place].labware:
            run = find_owning_run(bench.labware[name].owner)
            if run:
                yield run, name, place
        for name in bench.lost if place in bench.uncertain_at else ():
            run = find_owning_run(bench.labware[name].owner)
            if run and place in bench.labware[name].maybe:
                yield run, name, place


def check_left_out(state: LabState, run: RunState, step: PlanStep, others: Collection[RunId]) -> Wait | None:
    """Whether labware in the module would take part although its run does not start this step. ``others`` are
    the runs that start it together with this one."""
    if find_together(state, step) is None:
        return None
    for owner, labware, place in list_inside(state, step.module):
        if owner != run.id and owner not in others:
            why = reasons.InsideToo(str(labware), str(place), run_owner(owner), step.action)
            return Wait(why, (station_key(place), module_key(step.module), run_key(owner)))
    return None
