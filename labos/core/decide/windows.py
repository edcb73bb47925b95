"""Windows: the run whose step starts the clock, and the events when a step starts too late."""

from __future__ import annotations

from collections.abc import Iterator

from labos.core.decide._base import Rejection
from labos.core.ids import ExperimentId, RunId
from labos.core.model import Plan, Window
from labos.core.registry import Event
from labos.core.runs import Anchor, EndTimes, RunEnd, RunPaused, RunResumed, RunStarted, RunState
from labos.core.state import LabState
from labos.core.topics import Approval, ClosingWaits, FailedStep, LateStep, SecondPerson


def list_outer_windows(plan: Plan) -> list[Window]:
    """The windows whose clock a step of another run starts."""
    return [window for step in plan.steps for window in step.windows if window.of]


def find_anchors(state: LabState, plan: Plan, experiment: ExperimentId) -> tuple[Anchor, ...] | Rejection:
    """The ends of steps to which the plan's windows refer: those of the last completed run of a workflow, or
    of the run with that id, in the same experiment."""
    found: dict[tuple[str, str], Anchor] = {}
    for window in list_outer_windows(plan):
        named = (window.of, window.of_step)
        if named in found:
            continue
        if not experiment:
            return Rejection(
                "no_anchor",
                f"A window is anchored at {window.of!r}, but this run belongs to no experiment.",
                "Submit both runs in one experiment.",
            )
        past = state.runs.past.get(experiment, {})
        name = _choose_run(past, window.of)
        if name is None:
            return Rejection(
                "no_anchor",
                f"A window is anchored at {window.of!r}, but no run of it has been completed in "
                f"{experiment}.",
                "Submit this run when that one is completed.",
            )
        ended = past[name].ended_at.get(window.of_step)
        if ended is None:
            keys = ", ".join(repr(key) for key in past[name].ended_at)
            return Rejection(
                "no_anchor",
                f"A window is anchored at {window.of_step!r}, which is not a step of {name} ({window.of}).",
                f"Its steps are: {keys}.",
            )
        found[named] = Anchor(window.of, window.of_step, name, ended)
    return tuple(found.values())


def _choose_run(past: dict[RunId, EndTimes], of: str) -> RunId | None:
    name = RunId(of)
    if name in past:
        return name
    return next((run for run in reversed(past) if past[run].workflow == of), None)


def find_clock(run: RunState, plan: Plan, window: Window) -> tuple[str, str]:
    """The run (empty: the same run) and the step that started a window's clock."""
    if window.anchor is not None:
        return "", plan.steps[window.anchor].key
    meant = (window.of, window.of_step)
    anchor = next((a for a in run.anchors if (a.of, a.step) == meant), None)
    return (anchor.run if anchor else window.of), window.of_step


def describe_lateness(run: RunState, plan: Plan, step: int, window: Window) -> str:
    """Which step is too late, and after which other step; without a full stop."""
    other, anchor = find_clock(run, plan, window)
    whose = f" of run {other}" if other else ""
    within = window.within_s or 0.0
    return f"step {plan.steps[step].key!r} did not start within {within:g} s of the end of {anchor!r}{whose}"


def ask_about_breach(state: LabState, run: RunState, step: int, what: str) -> list[Event]:
    """The run stands still until a person has decided about it."""
    events: list[Event] = [] if run.paused else [RunPaused(run.id)]
    return [
        *events,
        state.interventions.ask(
            LateStep(run=run.id, step=step),
            f"Run {run.id} ({run.workflow}): {what.rstrip('.')}. The run has stopped.",
        ),
    ]


# -- reactions -----------------------------------------------------------------------------------


def withdraw_late_questions(state: LabState, event: RunResumed) -> Iterator[Event]:
    """When a person resumes a run, the questions about its late steps are withdrawn."""
    for question in state.interventions.find_by_run(event.run, LateStep):
        yield question.withdraw("the run was resumed")


def withdraw_run_questions(state: LabState, event: RunStarted | RunEnd) -> Iterator[Event]:
    """When a run starts or ends, the questions about it and its steps are withdrawn."""
    why = "the run has begun" if isinstance(event, RunStarted) else "the run has ended"
    topics = (LateStep, FailedStep, ClosingWaits, SecondPerson, Approval)
    for question in state.interventions.find_by_run(event.run, *topics):
        yield question.withdraw(why)
