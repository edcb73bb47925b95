"""Submitting, pausing and resuming runs; and the events when a step misses its window."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import Any

from labos.core.branches import sort_by_predecessors
from labos.core.canonical import digest, encode_canonical
from labos.core.decide._base import Command, Decision, InnerCommand, Rejection, decides
from labos.core.decide.choices import compare_plans
from labos.core.decide.endings import give_up
from labos.core.decide.lookups import decides_about, expect_run
from labos.core.decide.windows import (
    ask_about_breach,
    describe_lateness,
    find_anchors,
    find_clock,
)
from labos.core.effects import Consumes, list_carried, list_places
from labos.core.ids import CampaignId, ExperimentId, ModuleName, RunId, StationName, local, workcell_of
from labos.core.model import Plan, PlanStep
from labos.core.open_experiments import Experiment, ExperimentStatus
from labos.core.plans import PlanRecorded, PlanStepsRecorded
from labos.core.quotas import explain_full_queue
from labos.core.registry import Event
from labos.core.repeated import record_repeat
from labos.core.resources import sum_needed
from labos.core.runs import PENDING, RunPaused, RunResumed, RunState, RunStatus, RunSubmitted, find_anchor
from labos.core.state import LabState
from labos.core.steps import WindowBreached
from labos.core.structs import make_from
from labos.core.topics import LateStep
from labos.core.words import Words

STEPS_PER_EVENT = 16

QUOTA = "quota"
"""The code of a rejection of a run for which its user's quota leaves no room."""

QUOTA_REMEDY = "Wait until some have started, or cancel some."


NOBODYS = CampaignId("")
"""Stands for the campaign of runs that belong to no campaign."""


class SubmitRun(Command, frozen=True):
    """Queue a run of a compiled plan. ``request`` is an idempotency key: the same key twice is one run.
    ``pins`` are digests by name. ``propose``: it waits for an approval, even if the policy does not demand
    one. ``others`` are plans of the same steps on other modules; at its start the run may choose one of them
    instead of ``plan``. ``apart``: the campaign that does not share its plans. ``due_at`` is its due date
    (UTC ns, 0: none)."""

    plan: Plan
    user: str
    payload: dict[str, Any] = {}
    experiment: ExperimentId = ExperimentId("")
    priority: int = 0
    pins: dict[str, str] = {}
    request: str = ""
    propose: bool = False
    others: tuple[Plan, ...] = ()
    apart: CampaignId = NOBODYS
    due_at: int = 0

    @property
    def plans(self) -> tuple[Plan, ...]:
        """All plans from which the run may choose."""
        return (self.plan, *self.others)


class PauseRun(Command, frozen=True):
    """``why`` is a reason for the log."""

    run: RunId
    why: Words = ""


class ResumeRun(Command, frozen=True):
    run: RunId


class BreachWindow(InnerCommand, frozen=True):
    """The latest time for a step has passed, and the step has not started."""

    run: RunId
    step: int
    window: int
    now: int


def plan_digest(plan: Plan, apart: str = "") -> str:
    """The name of a plan. A campaign that does not share its plans has other names for them."""
    name = digest(encode_canonical(plan))
    return digest(f"{apart} {name}".encode()) if apart else name


def record_plan(state: LabState, plan: Plan, name: str, by: str, apart: CampaignId = NOBODYS) -> list[Event]:
    """The events that record a plan; none if it is recorded already."""
    if name in state.runs.plans:
        return []
    parts = [
        [
            [s.module, s.effects, s.after, s.exclusive, s.windows, s.duration_s, s.recovers, s.retry],
            [s.part, s.on_error, s.when],
            *_list_setups(state, s),
        ]
        for s in plan.steps
    ]
    events: list[Event] = [
        make_from(
            PlanRecorded,
            plan,
            by=by,
            plan=name,
            shape=digest(encode_canonical([parts, plan.holds])),
            steps=len(plan.steps),
            campaign=apart,
        )
    ]
    for first in range(0, len(plan.steps), STEPS_PER_EVENT):
        steps = plan.steps[first : first + STEPS_PER_EVENT]
        events.append(PlanStepsRecorded(by, name, first, steps, apart))
    return events


def _list_setups(state: LabState, step: PlanStep) -> list[Any]:
    """The values for which a step's module is set up. Runs with different values wait in different queues."""
    module = state.modules.by_name.get(step.module)
    setup = module.spec.setup if module is not None else None
    return [] if setup is None or setup.argument not in step.args else [step.args[setup.argument]]


def find_plan_flaw(state: LabState, plan: Plan) -> Rejection | None:
    """Why a plan can never be carried out in this lab; None if it can."""
    if not plan.steps:
        return Rejection("empty", f"The workflow {plan.workflow!r} has no steps.", "Add a step.")
    if plan.workcell not in state.lab.workcells:
        return Rejection("no_workcell", f"This lab has no workcell {plan.workcell!r}.")
    for step in plan.steps:
        missing = "" if step.module in state.modules.by_name else f"module {local(step.module)}"
        for place in sorted(name for name in list_places(step.effects) if name not in state.bench.stations):
            missing = missing or f"station {local(place)}"
        used: list[ModuleName | StationName] = [step.module, *sorted(list_places(step.effects))]
        elsewhere = [name for name in used if name and workcell_of(name) != plan.workcell]
        if elsewhere and not missing:
            return Rejection(
                "other_workcell",
                f"Step {step.key!r} uses {elsewhere[0]}, which is not in the workcell {plan.workcell}.",
                "A workflow runs in one workcell; submit one for each.",
            )
        if missing:
            code = f"no_{missing.partition(' ')[0]}"
            message = f"Step {step.key!r} needs the {missing}, which {plan.workcell} does not have."
            return Rejection(code, message)
        beyond = _check_capacity(state, step)
        if beyond:
            return beyond
    possible = {*sort_by_predecessors({index: step.after for index, step in enumerate(plan.steps)})}
    if len(possible) < len(plan.steps):
        names = ", ".join(repr(step.key) for index, step in enumerate(plan.steps) if index not in possible)
        return Rejection("cycle", f"The steps {names} wait for each other, or for steps that are not there.")
    for step in plan.steps:
        if any(not window.of and window.anchor not in possible for window in step.windows):
            return Rejection("no_anchor", f"A window of step {step.key!r} has no step as its anchor.")
    return None


def _check_capacity(state: LabState, step: PlanStep) -> Rejection | None:
    """Why a step could not start even on a full module; None if it could."""
    for effect in step.effects:
        if not isinstance(effect, Consumes):
            continue
        level = state.resources.find(step.module, effect.resource)
        amount = sum_needed(step.effects, effect.resource)
        if level is not None and amount > level.capacity:
            return Rejection(
                "beyond_capacity",
                f"Step {step.key!r} needs {amount:g} of {effect.resource}, but {local(step.module)} "
                f"holds at most {level.capacity:g}.",
                "Split the step, so that a person can refill the module between the parts.",
            )
    return None


@decides(SubmitRun)
def submit_run(state: LabState, command: SubmitRun) -> Decision:
    if command.request and command.request in state.runs.requests:
        return []
    experiment = None
    if command.experiment:
        experiment = state.experiments.open.get(command.experiment)
        if experiment is None or experiment.status != ExperimentStatus.OPEN:
            is_so = "is not open" if experiment is None else f"is {experiment.status}: it takes no more runs"
            return Rejection("no_experiment", f"The experiment {command.experiment} {is_so}.")
    user = experiment.user if experiment else command.user
    full = explain_full_queue(state, user)
    if full:
        return Rejection(QUOTA, full, QUOTA_REMEDY)
    run = RunId(f"R{state.runs.named + 1}")
    try:
        plans = {plan_digest(plan, command.apart): plan for plan in command.plans}
    except (ValueError, TypeError) as error:
        return Rejection("unfit", f"This cannot be recorded: {str(error).rstrip('.')}.")
    name = next(iter(plans))
    for digest_, plan in plans.items():
        flaw = None if digest_ in state.runs.plans else find_plan_flaw(state, plan)
        flaw = flaw or (_check_parking(state, plan, experiment) if experiment is not None else None)
        if flaw:
            return flaw
    differ = compare_plans(command.plan, command.others)
    if differ:
        return differ
    anchors = find_anchors(state, command.plan, command.experiment)
    if isinstance(anchors, Rejection):
        return anchors
    events: list[Event] = [
        *(e for one, plan in plans.items() for e in record_plan(state, plan, one, run, command.apart)),
        make_from(
            RunSubmitted,
            command,
            run=run,
            plan=name,
            workflow=command.plan.workflow,
            user=user,
            anchors=anchors,
            planned_by=state.runs.find_plan_stream(name),
            choices=tuple(plans) if len(plans) > 1 else (),
        ),
    ]
    return events


def _check_parking(state: LabState, plan: Plan, experiment: Experiment) -> Rejection | None:
    """Check that a run of an experiment with parking stations leaves labware only there, in storage, or
    nowhere. Only labware that the run itself carries counts, in the order of its steps."""
    if not experiment.parking:
        return None
    ends: dict[StationName, str] = {}
    for step in plan.steps:
        for what in list_carried(step.effects):
            ends.pop(what.emptied, None)
            if what.filled:
                ends[what.filled] = step.key
    for place, key in ends.items():
        if place not in experiment.parking and not state.bench.stations[place].spec.is_storage:
            return Rejection(
                "no_parking",
                f"The workflow {plan.workflow!r} leaves labware at {local(place)} (step {key!r}), where "
                f"{experiment.id} does not park.",
                f"Bring it to {', '.join(map(local, experiment.parking))}, to storage or to waste; or name "
                f"{local(place)} as parking when the experiment starts.",
            )
    return None


@decides_about(PauseRun, expect_run)
def pause_run(state: LabState, command: PauseRun, run: RunState) -> Decision:
    if run.paused:
        return record_repeat(command.run, "pause", command.why)
    return [RunPaused(command.run, command.why)]


@decides_about(ResumeRun, expect_run)
def resume_run(state: LabState, command: ResumeRun, run: RunState) -> Decision:
    return [RunResumed(command.run)] if run.paused else []


@decides(BreachWindow)
def breach_window(state: LabState, command: BreachWindow) -> Decision:
    run = state.runs.get(command.run)
    if run is None or run.is_breached(command.step):
        return []
    plan = state.runs.plan_of(run)
    window = plan.steps[command.step].windows[command.window]
    if find_anchor(run, window) is None or (run.has_started and run.steps[command.step].status != PENDING):
        return []
    started_by, _ = find_clock(run, plan, window)
    within = window.within_s or 0.0
    breached = WindowBreached(run.id, command.step, window.anchor, within, started_by)
    if run.is_ending:
        return [breached]  # the run ends in any case
    what = describe_lateness(run, plan, command.step, window)
    if window.on_breach == "fail":
        return chain([breached], give_up(state, run, what))
    return [
        breached,
        *(ask_about_breach(state, run, command.step, what) if window.on_breach == "ask" else ()),
    ]


def answer_late(state: LabState, topic: LateStep, choice: str) -> Iterator[Event]:
    """The events that follow when a person decides about a run with a late step."""
    run = state.runs.get(topic.run)
    if run is None or run.status == RunStatus.CANCELLING:
        return
    if choice == "fail":
        key = state.runs.plan_of(run).steps[topic.step].key
        yield from give_up(state, run, f"step {key!r} was too late and was given up")
    elif run.paused and not state.interventions.find_by_run(run.id, LateStep):
        yield RunResumed(run.id)
