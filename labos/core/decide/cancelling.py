"""Cancelling runs: actions in flight end first; then the ``on_cancel`` steps of the plan clear the labware
away."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from labos.core.decide._base import Command, Decision, InnerCommand, list_possible
from labos.core.decide.endings import has_open_action, record_end
from labos.core.decide.lookups import decides_about, expect_run, find_active_run
from labos.core.ids import RunId
from labos.core.leaving import find_bench_of_run, find_way_out, has_lost_labware, list_steps_out, will_leave
from labos.core.registry import Event
from labos.core.repeated import record_repeat
from labos.core.runs import RunCancelled, RunCancelling, RunLeaving, RunState, RunStatus
from labos.core.state import LabState
from labos.core.words import Words


class CancelRun(Command, frozen=True):
    """``stay``: its labware stays where it is, even if the run has ``on_cancel`` steps or is carrying them
    out. ``why`` is a reason for the log."""

    run: RunId
    stay: bool = False
    why: Words = ""


class TakeWayOut(InnerCommand, frozen=True):
    """Nothing of a cancelled run is in flight any more. Planning sends this command after everything that
    follows from the last result. Here it is computed which ``on_cancel`` steps the run needs (decision
    69)."""

    run: RunId


class GiveUpWayOut(InnerCommand, frozen=True):
    """A run cannot complete its ``on_cancel`` steps, whatever the other runs do."""

    run: RunId


@decides_about(CancelRun, expect_run)
def cancel_run(state: LabState, command: CancelRun, run: RunState) -> Decision:
    if run.is_ending and (run.stay or not command.stay):
        return record_repeat(command.run, "cancel", command.why)
    may_leave = run.status == RunStatus.ACTIVE and not command.stay
    if (may_leave and list_steps_out(state.runs.plan_of(run))) or has_open_action(run):
        return [RunCancelling(command.run, stay=command.stay, reason=command.why)]
    return record_end(state, run, RunCancelled(command.run, command.why), "was cancelled")


def cancel_all(
    state: LabState, runs: Iterable[RunId], why: str = "", *, stay: bool = False
) -> Iterator[Event]:
    """Cancel runs, one after the other, as far as possible."""
    for run in list(runs):
        yield from list_possible(cancel_run(state, CancelRun(run, stay, why)))


@decides_about(TakeWayOut, find_active_run)
def take_way_out(state: LabState, command: TakeWayOut, run: RunState) -> Decision:
    plan = state.runs.plan_of(run)
    if has_open_action(run) or not will_leave(plan, run):
        return []
    steps = () if has_lost_labware(state, run) else find_way_out(plan, find_bench_of_run(state, run))
    if steps:
        return [RunLeaving(run.id, steps)]
    return record_end(state, run, RunCancelled(run.id), "was cancelled")


@decides_about(GiveUpWayOut, find_active_run)
def give_up_way_out(state: LabState, command: GiveUpWayOut, run: RunState) -> Decision:
    if run.status != RunStatus.LEAVING or has_open_action(run):
        return []
    return record_end(state, run, RunCancelled(run.id), "was cancelled, and its way out is blocked")
