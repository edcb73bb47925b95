"""The order of runs by set-up time: the run that needs the least set-up goes first."""

from __future__ import annotations

from typing import Any

from labos.core.ids import ModuleName
from labos.core.rules import convert_lab_s
from labos.core.runs import PENDING, RunState
from labos.core.setups import Setup
from labos.core.state import LabState
from labos.planning.forecast import find_setup_ns


class SetupOrder:
    """Ranks runs by the set-up time that they need. Results count for one turn (``forget``)."""

    def __init__(self) -> None:
        self._by_plan: dict[str, int] = {}
        self._setups: dict[str, dict[ModuleName, tuple[Setup, Any]]] = {}

    def forget(self) -> None:
        """Forget all results, because modules may be set up for other work now."""
        self._by_plan.clear()
        self._setups.clear()

    def rank(self, state: LabState, run: RunState, step: int | None) -> int:
        """The set-up time before a step (ns of wall time). With ``step`` None, the run is queued: the sum for
        its first step with a set-up on each module. The least goes first."""
        plan = state.runs.plan_of(run)
        if step is not None:
            return find_setup_ns(state, plan.steps[step])
        setups = self._setups.get(plan.workcell)
        if setups is None:
            setups = self._setups[plan.workcell] = _list_setups(state, plan.workcell)
        if not setups:
            return 0
        known = self._by_plan.get(run.plan)
        if known is None:
            known = self._by_plan[run.plan] = _count(state, run, setups)
        return known


def _count(state: LabState, run: RunState, setups: dict[ModuleName, tuple[Setup, Any]]) -> int:
    """The set-up time for the first step with a set-up on each module (ns of wall time)."""
    seen: set[ModuleName] = set()
    total = 0.0
    for step in state.runs.plan_of(run).steps:
        if step.module in setups and step.module not in seen:
            setup, value = setups[step.module]
            if setup.argument in step.args:
                seen.add(step.module)
                total += setup.compute_cost_s(value, step.args)
    return convert_lab_s(state, total)


def _list_setups(state: LabState, cell: str) -> dict[ModuleName, tuple[Setup, Any]]:
    """The modules of a workcell that need set-ups, and the value for which each will be set up after the runs
    inside have used it. If several of them still use it, the run that was admitted last counts."""
    found: dict[ModuleName, tuple[Setup, Any]] = {}
    for name in state.modules.in_cell.get(cell, ()):
        module = state.modules.by_name[name]
        if module.spec.setup is not None:
            found[name] = module.spec.setup, module.set_up_for
    for run in state.runs.list_inside(cell) if found else ():
        for step, known in zip(state.runs.plan_of(run).steps, run.steps, strict=True):
            if step.module in found and known.status is PENDING:
                setup, value = found[step.module]
                found[step.module] = setup, step.args.get(setup.argument, value)
    return found
