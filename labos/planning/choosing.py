"""Chooses the modules of a run that has one plan for each choice: those that are done first.

A run is bound to a plan when it is admitted. It changes to another plan only if a module that it still needs
is down, if all steps that have begun are the same in both, and if no run loses its way to the end.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from labos.core.decide.choices import BindAnew, can_change_to
from labos.core.ids import ModuleName, local, workcell_of
from labos.core.runs import RunState, find_chosen_modules, list_options
from labos.core.state import LabState
from labos.planning.forecast import find_usual_time, list_left
from labos.planning.layout import is_down
from labos.planning.safety import Safety
from labos.planning.stuck import find_block


def sort_options(state: LabState, run: RunState, now: int) -> list[RunState]:
    """A waiting run, once with each of its plans. The plan with which all chosen modules are done first comes
    first. A run without a choice is returned as it is."""
    found = list_options(run)
    if len(found) == 1:
        return found
    loads: dict[ModuleName, int] = {}

    def estimate_end(option: RunState) -> int:
        chosen = set(find_chosen_modules(state.runs, option).values())
        for module in chosen - loads.keys():
            loads[module] = _load(state, module, now)
        return max((loads[module] + _sum_own_time(state, option, module) for module in chosen), default=0)

    return sorted(found, key=estimate_end)


def _load(state: LabState, module: ModuleName, now: int) -> int:
    """The time that a module still has to work for the runs inside (ns of wall time)."""
    cell = workcell_of(module)
    total = 0
    for run in state.runs.list_inside(cell):
        own = (step for step in list_left(state, run) if step.module == module)
        total += sum(find_usual_time(state, step) for step in own)
    for action in state.actions.list_in_cell(cell):
        if action.module == module:
            total -= max(0, now - action.requested_at)
    return max(0, total)


def _sum_own_time(state: LabState, run: RunState, module: ModuleName) -> int:
    return sum(find_usual_time(state, s) for s in state.runs.plan_of(run).steps if s.module == module)


def list_changes(state: LabState, safety: Safety) -> Iterator[BindAnew]:
    """The changes of runs inside to another of their plans, because a module that they need is down."""
    if not state.runs.choosing:
        return
    cells = {state.runs.plan_of(state.runs.active[name]).workcell for name in state.runs.choosing}
    dead = {name for cell in cells for name in state.modules.in_cell.get(cell, ()) if is_down(state, name)}
    for name in list(state.runs.choosing) if dead else ():
        run = state.runs.active[name]
        cause = next((step.module for step in list_left(state, run) if step.module in dead), None)
        if cause is None:
            continue
        for plan in run.choices:
            option = msgspec.structs.replace(run, plan=plan)
            if (
                plan == run.plan
                or not can_change_to(state, run, plan)
                or any(step.module in dead for step in list_left(state, option))
            ):
                continue
            if find_block(state, option) is None and safety.is_change_safe(state, option):
                yield BindAnew(run.id, plan, f"{local(cause)} cannot be used")
                break
