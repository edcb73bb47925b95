"""The progress of the steps of runs."""

from __future__ import annotations

from labos.core.actions import (
    ActionAccepted,
    ActionFailed,
    ActionReconciled,
    ActionRejected,
    ActionReported,
    ActionRequested,
    ActionSucceeded,
    ActionUnknown,
)
from labos.core.ids import RunId
from labos.core.registry import Event, event
from labos.core.runs import (
    DONE,
    FAILED,
    IN_FLIGHT,
    PENDING,
    SKIPPED,
    UNKNOWN,
    RunEvent,
    Runs,
    RunState,
    StepStatus,
    list_rescue_steps,
    make_first_states,
)


@event("window.breached", schema=2)
class WindowBreached(RunEvent, frozen=True):
    """A step did not start within ``within_s`` lab seconds after its anchor: the step ``anchor`` of its own
    run or, if that is null, a step of the run ``of``."""

    step: int
    anchor: int | None
    within_s: float
    of: str = ""


@event("step.retried")
class StepRetried(RunEvent, frozen=True):
    """A failed step will be tried again: retry ``number`` of ``times``, ``delay_s`` lab seconds from now."""

    step: int
    number: int
    times: int
    delay_s: float
    why: str


class StepEvent(RunEvent, frozen=True):
    step: int
    why: str


@event("step.skipped")
class StepSkipped(StepEvent, frozen=True):
    """A step is skipped, or it failed and the run continues without it."""


@event("step.unexpected")
class StepUnexpected(StepEvent, frozen=True):
    """A step's result is not what the workflow expects (an *experiment error*)."""


@event("step.recovering")
class StepRecovering(StepEvent, frozen=True):
    """A step failed. The steps under its ``on_error`` are carried out."""


def fold_window_breached(runs: Runs, event: WindowBreached, at: int) -> None:
    run = runs.get(event.run)
    if run is not None:
        if not run.steps:  # the run waits for its start
            run.steps = make_first_states(runs.plan_of(run))
        run.steps[event.step].breached = True


def fold_action_requested(runs: Runs, event: ActionRequested, at: int) -> None:
    if event.run in runs.active:
        runs.active[event.run].steps[event.step].status = IN_FLIGHT


_STATUS: dict[type[Event], StepStatus] = {
    ActionAccepted: IN_FLIGHT,
    ActionReported: IN_FLIGHT,
    ActionFailed: FAILED,
    ActionUnknown: UNKNOWN,
}


def fold_action_status(
    runs: Runs, event: ActionAccepted | ActionReported | ActionFailed | ActionUnknown, at: int
) -> None:
    _mark(runs, event.run, event.step, _STATUS[type(event)])


def fold_action_rejected(runs: Runs, event: ActionRejected, at: int) -> None:
    _mark(runs, event.run, event.step, FAILED if event.final else PENDING)


def fold_step_retried(runs: Runs, event: StepRetried, at: int) -> None:
    run = _mark(runs, event.run, event.step, PENDING)
    if run is not None:
        run.steps[event.step].retries, run.steps[event.step].retried_at = event.number, at
        retry = runs.plan_of(run).steps[event.step].retry
        if retry is not None and retry.reset is not None:
            run.steps[retry.reset].status = PENDING


def fold_step_skipped(runs: Runs, event: StepSkipped, at: int) -> None:
    run = _mark(runs, event.run, event.step, SKIPPED)
    if run is not None:
        run.steps[event.step].ended_at = at
        for index, step in enumerate(runs.plan_of(run).steps):
            if step.part == event.step and run.steps[index].status != DONE:
                run.steps[index].status = SKIPPED


def fold_step_unexpected(runs: Runs, event: StepUnexpected, at: int) -> None:
    run = _mark(runs, event.run, event.step, FAILED)
    if run is not None:
        run.steps[event.step].result = None


def fold_step_recovering(runs: Runs, event: StepRecovering, at: int) -> None:
    run = _mark(runs, event.run, event.step, FAILED)
    if run is not None:
        run.steps[event.step].trouble = event.why
        for index in list_rescue_steps(runs.plan_of(run), event.step):
            run.steps[index].status = PENDING


def fold_action_succeeded(runs: Runs, event: ActionSucceeded, at: int) -> None:
    # The time of a clock that is ahead of the log's clock is not used.
    _end(runs, event, event.ended_ns if 0 < event.ended_ns <= at else at)


def fold_action_reconciled(runs: Runs, event: ActionReconciled, at: int) -> None:
    if event.effects == "all":
        _end(runs, event, at)
    else:
        _mark(runs, event.run, event.step, PENDING if event.effects == "none" else FAILED)


def _end(runs: Runs, event: ActionSucceeded | ActionReconciled, ended_at: int) -> None:
    run = _mark(runs, event.run, event.step, DONE)
    if run is not None:
        run.steps[event.step].ended_at = ended_at
        if event.step in runs.plan_of(run).feeds:
            run.steps[event.step].result = event.result


def _mark(runs: Runs, name: RunId, step: int, status: StepStatus) -> RunState | None:
    run = runs.active.get(name)
    if run is not None:
        run.steps[step].status = status
    return run
