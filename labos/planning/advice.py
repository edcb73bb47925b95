"""Finds other advice for the next rehearsal if a step was late."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from labos.core.ids import RunId
from labos.core.model import PlanStep
from labos.core.runs import PENDING, RunState
from labos.core.state import LabState
from labos.planning.forecast import find_pending_before, find_run
from labos.planning.player import FAR, Step, Who, find_step
from labos.planning.rehearsal import Advice, RehearsalResult


def list_options(
    state: LabState,
    run: RunState | None,
    advice: Advice,
    outcome: RehearsalResult,
    late: Step,
    forced: Step | None,
) -> Iterator[Advice]:
    """Other advice that may bring a late step in time. Runs that would be trapped go to their ends first. A
    run in its way goes on to its end, or waits until the blocked step has started. Or its clock starts later.
    ``run`` is a run that is to start. The step ``forced`` starts whatever the advice is."""
    mover = find_run(state, late[0])
    what = state.runs.plan_of(mover)
    if outcome.trap is not None and outcome.trap[0] != forced:
        yield from _let_pass(state, advice, *outcome.trap)
    for step, other in _list_in_the_way(mover, find_pending_before(mover, what, late[1]), advice, outcome):
        begun = find_step(other)
        if begun in outcome.starts and begun is not None and begun != forced:
            yield advice.put_behind(begun, step)
        can_go = RunId(other[0]) in state.runs.active or (run is not None and other[0] == run.id)
        if other[0] not in advice.leaving and can_go:
            yield advice.let_leave(other[0])
    by = outcome.late[late]
    for index in _list_clocks(what.steps[late[1]]):
        anchor = (late[0], index)
        if anchor in outcome.starts and anchor != forced and by < FAR:
            yield advice.put_off(anchor, outcome.starts[anchor] + by)


def _let_pass(state: LabState, advice: Advice, start: Step, lost: Sequence[str]) -> Iterator[Advice]:
    """For each run that a start would trap: advice by which it goes to its end before this start."""
    for name in lost:
        run = state.runs.active.get(RunId(name))
        if run is not None and name != start[0]:
            last = max((i for i, step in enumerate(run.steps) if step.status == PENDING), default=0)
            yield advice.let_leave(name).put_behind(start, (name, last))


def _list_in_the_way(
    run: RunState, chain: Sequence[int], advice: Advice, outcome: RehearsalResult
) -> Iterator[tuple[Step, Who]]:
    """The steps of ``chain`` that had to wait, each with what was in its way. Then the same for the steps of
    runs in the way that leave."""
    blocked = [(str(run.id), index) for index in reversed(chain)]
    seen = {blocked[0][0]}
    while blocked:
        step = blocked.pop(0)
        for other in reversed(list(outcome.blame.get(step, ()))):
            if not other[0]:
                continue
            yield step, other
            if other[0] in advice.leaving and other[0] not in seen:
                seen.add(other[0])
                blocked += [who for who in outcome.blame if who[0] == other[0]]


def _list_clocks(step: PlanStep) -> list[int]:
    """The steps that start a step's clocks."""
    return [w.anchor for w in step.windows if w.anchor is not None and w.within_s is not None]
