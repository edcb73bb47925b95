"""Cancelling runs: what is in flight is let finish; then labware goes the way out that the plan has."""

from __future__ import annotations

from labos.core.decide._base import Command, Decision, Rejection, decides
from labos.core.decide.endings import ending, under_way
from labos.core.decide.runs import alive
from labos.core.ids import RunId
from labos.core.leaving import lost, scene_of, steps_out, way_out, will_leave
from labos.core.runs import RunCancelled, RunCancelling, RunLeaving
from labos.core.state import LabState


class CancelRun(Command, frozen=True):
    """``stay``: its labware stays where it is, also if the run has a way out or goes it already. ``why``
    is recorded with what this changes."""

    run: RunId
    stay: bool = False
    why: str = ""


class TakeWayOut(Command, frozen=True):
    """Nothing of a cancelled run is in flight any more."""

    run: RunId


class GiveUpWayOut(Command, frozen=True):
    """A run cannot go its way out to its end, whatever the others do."""

    run: RunId


@decides(CancelRun)
def cancel_run(state: LabState, command: CancelRun) -> Decision:
    run = alive(state, command.run)
    if isinstance(run, Rejection):
        return run
    if run.status in ("cancelling", "leaving") and (run.stay or not command.stay):
        return []
    leaves = run.status == "active" and not command.stay and bool(steps_out(state.runs.plan_of(run)))
    if leaves or under_way(run):
        return [RunCancelling(command.run, stay=command.stay, reason=command.why)]
    return ending(state, run, RunCancelled(command.run, command.why), "was cancelled")


@decides(TakeWayOut)
def take_way_out(state: LabState, command: TakeWayOut) -> Decision:
    run = state.runs.active.get(command.run)
    if run is None or under_way(run) or not will_leave(state.runs.plan_of(run), run):
        return []
    if lost(state, run):
        return ending(state, run, RunCancelled(run.id), "was cancelled")
    steps = way_out(state.runs.plan_of(run), scene_of(state, run))
    if not steps:
        return ending(state, run, RunCancelled(run.id), "was cancelled")
    return [RunLeaving(run.id, steps)]


@decides(GiveUpWayOut)
def give_up_way_out(state: LabState, command: GiveUpWayOut) -> Decision:
    run = state.runs.active.get(command.run)
    if run is None or run.status != "leaving" or under_way(run):
        return []
    return ending(state, run, RunCancelled(run.id), "was cancelled, and its way out is blocked")


__all__ = ["CancelRun", "GiveUpWayOut", "TakeWayOut"]
