"""Steps of several runs that a device carries out together, as a centrifuge does.

A run whose labware is in such a device waits for the labware of other runs that can be there in time. This is
only a preference. The wait ends when the device has no place left, when no other run can be there in time, or
when nothing moves in the workcell. At the latest it ends ``wait_s`` after the first run was ready. No run
waits while an active run with windows needs the device too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from labos.core import reasons
from labos.core.decide.together import find_planned_wish, find_wish
from labos.core.effects import list_places
from labos.core.ids import ModuleName
from labos.core.model import Plan, PlanStep
from labos.core.recurrence import in_zone
from labos.core.rules import convert_lab_s, examine
from labos.core.runs import PENDING, RunState, RunStatus, find_holds
from labos.core.state import LabState
from labos.core.together import find_together
from labos.core.waits import Wait
from labos.planning.forecast import find_pending_before, find_usual_time, list_left, list_ready_steps
from labos.planning.ranking import ReadyStart
from labos.planning.stuck import find_block
from labos.planning.touch import near_key

RunStep = tuple[RunState, int]


def find_companions(state: LabState, run: RunState, index: int, now: int) -> list[RunStep]:
    """The steps of other runs that can be carried out together with this step now."""
    step = state.runs.plan_of(run).steps[index]
    if find_together(state, step) is None or not run.has_started:
        return []
    wish = find_wish(state, run, index)
    found = [
        (other, at)
        for other, at in _list_ready(state, run, step.module)
        if wish is not None and find_wish(state, other, at) == wish
    ]
    while found:
        names = {run.id, *(other.id for other, _ in found)}
        able = [
            (other, at)
            for other, at in found
            if not isinstance(examine(state, other, at, now, names - {other.id}), Wait)
        ]
        if len(able) == len(found):
            break
        found = able
    return found


def _list_ready(state: LabState, run: RunState, module: ModuleName) -> Iterator[RunStep]:
    """For each other run inside, the first step on this module whose turn it is, if there is one."""
    plan = state.runs.plan_of(run)
    for other in state.runs.list_inside(plan.workcell):
        steps = state.runs.plan_of(other).steps
        ready = list_ready_steps(state, other) if other.id != run.id else []
        yield from [(other, index) for index in ready if steps[index].module == module][:1]


def check_for_others(
    state: LabState,
    run: RunState,
    index: int,
    companions: Iterable[RunStep],
    outside: Iterable[Plan],
    now: int,
) -> Wait | None:
    """The wait of a step, which could start with its ``companions``, for labware of other runs in its device.
    None if it starts now. ``outside`` are plans of queued runs."""
    plan = state.runs.plan_of(run)
    step = plan.steps[index]
    together = find_together(state, step)
    if together is None or not run.has_started:
        return None
    members = [(run, index), *companions]
    until = min(find_ready_time(state, one, at) for one, at in members) + convert_lab_s(
        state, together.wait_s
    )
    stations = [state.bench.stations[place] for place in state.bench.by_module.get(step.module, ())]
    stations = [station for station in stations if not station.spec.hotel]
    taken = sum(len(station.labware) for station in stations)
    room = sum(station.spec.capacity for station in stations)
    if now >= until or taken >= room or _is_needed_by_run_with_windows(state, plan.workcell, step.module):
        return None
    if not state.actions.is_any_moving(plan.workcell) or not _can_anybody_come(
        state, members, plan, step, outside, now, until
    ):
        return None
    why = reasons.ForOthers(step.action, str(step.module), str(taken), str(room), in_zone(until, "UTC"))
    return Wait(why, (near_key(plan.workcell),), until)


def put_last(state: LabState, starts: list[ReadyStart]) -> list[ReadyStart]:
    """The same starts. Steps that may be carried out together move to the end, to take into account what
    other runs start now. Steps of runs with windows keep their places."""

    def comes_late(start: ReadyStart) -> bool:
        if start.bundle or start.run.id in state.runs.windowed:
            return False
        return find_together(state, state.runs.plan_of(start.run).steps[start.step]) is not None

    return sorted(starts, key=comes_late) if len(starts) > 1 else starts


def find_ready_time(state: LabState, run: RunState, index: int) -> int:
    """The time from which no earlier step of its own run keeps a step from starting (UTC ns)."""
    ends = [run.steps[at].ended_at or 0 for at in state.runs.plan_of(run).steps[index].after]
    return max([run.submitted_at, *ends])


def _is_needed_by_run_with_windows(state: LabState, cell: str, module: ModuleName) -> bool:
    """Whether an active run with windows needs a module or a place there, even if no clock is running."""
    for name in state.runs.windowed_in.get(cell, ()):
        run = state.runs.active.get(name)
        for step in list_left(state, run) if run else ():
            if step.module == module or _reaches(state, step, module):
                return True
    return False


def _reaches(state: LabState, step: PlanStep, module: ModuleName) -> bool:
    return any(state.bench.stations[place].spec.module == module for place in list_places(step.effects))


def _can_anybody_come(
    state: LabState,
    members: list[RunStep],
    plan: Plan,
    step: PlanStep,
    outside: Iterable[Plan],
    now: int,
    until: int,
) -> bool:
    """Whether another run, with the same request to the device as this step, could be ready by ``until`` (UTC
    ns). False if the request depends on results of earlier steps."""
    wish, names = find_planned_wish(plan, step), {run.id for run, _ in members}
    if wish is None:
        return False
    for other in state.runs.list_inside(plan.workcell):
        theirs = state.runs.plan_of(other)
        for index in _list_wishes(theirs, step, wish) if other.id not in names else ():
            if other.steps[index].status is PENDING and _comes_by(state, other, index, now, until):
                return True
    for theirs in outside:
        for index in _list_wishes(theirs, step, wish):
            before = sum(find_usual_time(state, each) for each in theirs.steps[:index])
            if now + before <= until:
                return True
    return False


def _list_wishes(plan: Plan, step: PlanStep, wish: bytes) -> list[int]:
    """The steps of a plan with the same request (``wish``) as this step."""
    return [
        index
        for index, each in enumerate(plan.steps)
        if each.module == step.module and each.action == step.action and find_planned_wish(plan, each) == wish
    ]


def _comes_by(state: LabState, run: RunState, index: int, now: int, until: int) -> bool:
    """Whether a run inside can continue, and its step could start by ``until`` (UTC ns) without any delay."""
    if run.status != RunStatus.ACTIVE or find_holds(run) or find_block(state, run) is not None:
        return False
    plan = state.runs.plan_of(run)
    *before, _ = find_pending_before(run, plan, index)
    at = now
    for action in state.actions.list_in_cell(plan.workcell):
        if action.run == run.id:
            at = max(at, action.requested_at + find_usual_time(state, plan.steps[action.step]))
    return at + sum(find_usual_time(state, plan.steps[each]) for each in before) <= until
