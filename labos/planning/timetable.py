"""When the steps of a plan would run if it were alone on the bench and all steps took their nominal time.

A step starts when the steps before it are done and its waits have passed. Its module and the zones that it
reaches into must be free. If several steps could start at the same time, the one that is written first goes
first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from labos.core.effects import Consumes, list_carried
from labos.core.ids import ModuleName, StationName
from labos.core.lengths import Lengths
from labos.core.model import MAIN, Plan, PlanStep, Workcell
from labos.core.zones import find_zones_reached


class Slot(msgspec.Struct, frozen=True):
    """The time of a step, in seconds from the start of the run. ``held_by`` is the step whose end, with a
    wait, decides its start, if there is one. ``late_s`` is the time by which it misses a window."""

    start_s: float
    end_s: float
    held_by: int | None = None
    late_s: float = 0.0


class Timetable(msgspec.Struct, frozen=True):
    """The slots of the steps. The ``critical`` steps follow one another to the end of the run. If one of them
    becomes shorter, the run becomes shorter, until another path is the longest."""

    slots: tuple[Slot, ...]
    critical: tuple[int, ...]
    total_s: float
    busy_s: dict[ModuleName, float]


def make_timetable(plan: Plan, workcell: Workcell | None = None) -> Timetable:
    """The timetable of a plan if no step fails or is left out. Its steps must not wait for each other in a
    circle. The zones are those of the workcell. Steps after a cancellation have no time."""
    slots: dict[int, Slot] = {}
    free: dict[str, int] = {}
    needs = [find_occupied(step, workcell) for step in plan.steps]
    busy: dict[ModuleName, float] = {}
    waiting = {index for index, step in enumerate(plan.steps) if step.part == MAIN}
    while waiting:
        ready = [index for index in waiting if all(step in slots for step in find_before(plan.steps[index]))]
        index = min(ready, key=lambda i: (_start(plan.steps[i], slots, free, needs[i])[0], i))
        step = plan.steps[index]
        start_s, held_by = _start(step, slots, free, needs[index])
        slots[index] = Slot(
            start_s, start_s + step.duration_s, held_by, _measure_lateness_s(step, start_s, slots)
        )
        free.update(dict.fromkeys(needs[index], index))
        busy[step.module] = busy.get(step.module, 0.0) + step.duration_s
        waiting.discard(index)
    ordered = tuple(slots.get(index, Slot(0.0, 0.0)) for index in range(len(plan.steps)))
    total_s = max((slot.end_s for slot in ordered), default=0.0)
    return Timetable(ordered, _find_critical_steps(ordered, total_s), total_s, busy)


def with_learned(plan: Plan, lengths: Lengths, pace: float) -> Plan:
    """The plan with the learned usual durations where the lab knows them. Steps of people keep their
    durations. ``pace`` is the speed-up factor of the lab."""
    return msgspec.structs.replace(
        plan, steps=tuple(_with_learned(step, lengths, pace) for step in plan.steps)
    )


def _with_learned(step: PlanStep, lengths: Lengths, pace: float) -> PlanStep:
    known = lengths.estimate(step, pace)
    if known is None or step.by_person:
        return step
    return msgspec.structs.replace(step, duration_s=known.usual * pace / 1e9)


def find_setups(plan: Plan, workcell: Workcell, order: Sequence[int]) -> dict[int, float]:
    """How much longer steps take in this order because their modules are set up for them (lab seconds). The
    set-up of a module at the start is not known: the first step that needs one counts as a change."""
    setups = {module.name: module.setup for module in workcell.modules if module.setup is not None}
    values: dict[ModuleName, Any] = {}
    found: dict[int, float] = {}
    for index in order if setups else ():
        step = plan.steps[index]
        setup = setups.get(step.module)
        if setup is not None and setup.argument in step.args:
            cost_s = setup.compute_cost_s(values.get(step.module), step.args)
            values[step.module] = step.args[setup.argument]
            if cost_s:
                found[index] = cost_s
    return found


def with_setups(plan: Plan, setups: Mapping[int, float]) -> Plan:
    """The plan with the time for set-ups added to its steps."""
    if not setups:
        return plan
    steps = tuple(
        msgspec.structs.replace(step, duration_s=step.duration_s + setups.get(index, 0.0))
        for index, step in enumerate(plan.steps)
    )
    return msgspec.structs.replace(plan, steps=steps)


def sum_consumption(plan: Plan) -> dict[tuple[ModuleName, str], float]:
    """The amounts that the plan uses up if no step fails, by module and resource."""
    used: dict[tuple[ModuleName, str], float] = {}
    for step in _list_usual_steps(plan):
        for effect in step.effects:
            if isinstance(effect, Consumes):
                key = (step.module, effect.resource)
                used[key] = used.get(key, 0.0) + float(effect.amount)
    return used


def count_taken(plan: Plan) -> dict[StationName, int]:
    """The number of pieces of labware that the plan takes from each stack."""
    pieces: dict[StationName, int] = {}
    for step in _list_usual_steps(plan):
        for what in list_carried(step.effects):
            if what.stock:
                pieces[what.stock] = pieces.get(what.stock, 0) + 1
    return pieces


def _list_usual_steps(plan: Plan) -> list[PlanStep]:
    return [step for step in plan.steps if step.part == MAIN]


def _list_anchors(step: PlanStep) -> list[tuple[int, float, float | None]]:
    """The step's windows within the run: the step from whose end it counts, the least and the greatest
    time."""
    return [(w.anchor, w.wait_s, w.within_s) for w in step.windows if w.anchor is not None]


def find_before(step: PlanStep) -> set[int]:
    """The steps of the run that have to be done before a step."""
    return {*step.after, *(anchor for anchor, _, _ in _list_anchors(step))}


def find_occupied(step: PlanStep, workcell: Workcell | None) -> tuple[str, ...]:
    """The module and the zones that a step has exclusively. Without a workcell, no zones are known."""
    if not step.exclusive:
        return ()
    if workcell is None:
        return (step.module,)
    own = next((module.zone for module in workcell.modules if module.name == step.module), "")
    zones = {station.name: station.zone for station in workcell.stations if station.zone}
    return (step.module, *find_zones_reached(own, step.effects, lambda place: zones.get(place, "")))


def _start(
    step: PlanStep, slots: dict[int, Slot], free: dict[str, int], needs: tuple[str, ...]
) -> tuple[float, int | None]:
    """The time at which the step can start, and the step that decides this time (None: no step)."""
    holds = [(slots[index].end_s, index) for index in step.after]
    holds += [(slots[anchor].end_s + wait_s, anchor) for anchor, wait_s, _ in _list_anchors(step)]
    holds += [(slots[free[name]].end_s, free[name]) for name in needs if name in free]
    return max(holds, default=(0.0, None))


def _measure_lateness_s(step: PlanStep, start_s: float, slots: dict[int, Slot]) -> float:
    misses = [
        start_s - slots[anchor].end_s - within_s
        for anchor, _, within_s in _list_anchors(step)
        if within_s is not None
    ]
    return max([0.0, *misses])


def _find_critical_steps(slots: tuple[Slot, ...], total_s: float) -> tuple[int, ...]:
    """The steps that decide the end of the run, from the first to the last."""
    path: list[int] = []
    index = next((index for index, slot in enumerate(slots) if slot.end_s == total_s), None)
    while index is not None:
        path.append(index)
        index = slots[index].held_by
    return tuple(reversed(path))
