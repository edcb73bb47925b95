"""The steps of a closing workflow that are needed: those that find labware of the experiment, and those that
do not concern labware. The rule is the same as for the ``on_cancel`` steps of a cancelled run.

A closing run carries out a plan of these steps only. So one workflow can clear all places where an experiment
may have left labware.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import msgspec

from labos.core.branches import main_steps, sort_steps
from labos.core.effects import Needs, list_carried
from labos.core.ids import experiment_owner
from labos.core.leaving import BenchOfRun, carry_out, is_needed, look_at
from labos.core.model import Hold, Plan, PlanStep, Window
from labos.core.open_experiments import Experiment
from labos.core.state import LabState


def plan_closing(state: LabState, experiment: Experiment) -> Plan | None:
    """The needed steps of an experiment's closing workflow; None if it would clear nothing away."""
    plan = state.runs.plans[experiment.closing].plan
    scene = look_at(state, plan.workcell, experiment_owner(experiment.id))
    chosen = choose(plan, scene)
    if not chosen:
        return None
    return plan if len(chosen) == len(main_steps(plan)) or _is_tied(plan, chosen) else narrow(plan, chosen)


def choose(plan: Plan, scene: BenchOfRun) -> list[int]:
    """The steps that are needed from a scene; none if no labware is cleared away. The scene is changed to the
    state after these steps."""
    with_stations, found, clears = {*scene.owner.values()}, [], False
    for index in sort_steps(plan, main_steps(plan)):
        step = plan.steps[index]
        works_on = bool(list_carried(step.effects)) or any(isinstance(e, Needs) for e in step.effects)
        if (not works_on and step.module not in with_stations) or is_needed(step, scene):
            found.append(index)
            clears = clears or works_on
            carry_out(step, scene)
    return sorted(found) if clears else []


def narrow(plan: Plan, chosen: Sequence[int]) -> Plan:
    """The plan with these steps of the workflow only, and with the steps that serve them: recoveries, resets,
    and the ``on_cancel`` steps."""
    main = set(main_steps(plan)) - set(chosen)
    kept = [i for i, step in enumerate(plan.steps) if i not in main and step.serves not in main]
    number = {index: place for place, index in enumerate(kept)}
    return msgspec.structs.replace(
        plan,
        steps=tuple(_renumber(plan, plan.steps[index], number) for index in kept),
        feeds=tuple(number[index] for index in plan.feeds if index in number),
        holds=tuple(Hold(h.module, number[h.first], number[h.last]) for h in plan.holds if h.first in number),
    )


def _is_tied(plan: Plan, chosen: Sequence[int]) -> bool:
    """Whether steps cannot be left out, because other steps read their results, or because the run keeps a
    module from one of them to another."""
    left_out = set(main_steps(plan)) - set(chosen)
    reads = bool(plan.feeds) or any(step.when is not None for step in plan.steps)
    cut = any((hold.first in left_out) != (hold.last in left_out) for hold in plan.holds)
    return reads or cut


def _renumber(plan: Plan, step: PlanStep, number: dict[int, int]) -> PlanStep:
    served = step.serves
    retry = step.retry
    if retry is not None and retry.reset is not None:
        retry = msgspec.structs.replace(retry, reset=number[retry.reset])
    return msgspec.structs.replace(
        step,
        after=tuple(sorted({number[i] for i in _renumber_before(plan, step.after, number)})),
        windows=tuple(
            _renumber_anchor(window, number)
            for window in step.windows
            if window.anchor is None or window.anchor in number
        ),
        part=number[served] if served is not None else step.part,
        retry=retry,
    )


def _renumber_anchor(window: Window, number: dict[int, int]) -> Window:
    return window if window.anchor is None else msgspec.structs.replace(window, anchor=number[window.anchor])


def _renumber_before(plan: Plan, after: Iterable[int], number: dict[int, int]) -> list[int]:
    """The predecessors of a step by their new numbers. A predecessor that is left out is replaced by its own
    predecessors."""
    found: list[int] = []
    for index in after:
        found += [index] if index in number else _renumber_before(plan, plan.steps[index].after, number)
    return found
