"""Runs: their submission, their progress, and their queues."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from typing import Any

import msgspec

from labos.core.experiments import ExperimentEnded, ExperimentStarted
from labos.core.ids import CampaignId, ExperimentId, ModuleName, RunId
from labos.core.interventions import InterventionRequested
from labos.core.model import MAIN, Plan, Window
from labos.core.plans import PlanRecorded, PlanState, PlanStepsRecorded, release_plan
from labos.core.registry import Event, event
from labos.core.structs import make_from
from labos.core.topics import ClosingWaits
from labos.core.words import Words


class StepStatus(StrEnum):
    """The progress of a step. A skipped step is over: it was left out, or will never be carried out."""

    PENDING = "pending"
    IN_FLIGHT = "in flight"
    DONE = "done"
    FAILED = "failed"
    UNKNOWN = "unknown"
    SKIPPED = "skipped"

    __hash__ = str.__hash__  # planning looks statuses up often, and Enum's own hash is slow


PENDING, IN_FLIGHT, DONE = StepStatus.PENDING, StepStatus.IN_FLIGHT, StepStatus.DONE
FAILED, UNKNOWN, SKIPPED = StepStatus.FAILED, StepStatus.UNKNOWN, StepStatus.SKIPPED

SETTLED = (DONE, SKIPPED)
"""Statuses of steps for which no other step waits any more."""

REQUESTS_KEPT = 1000

PAST_KEPT = 100
"""The number of completed runs of an experiment to which later windows may refer. The last run of each
workflow is always kept."""


class Anchor(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The end of another run's step, from which a window of this run counts. ``of`` and ``of_step`` of the
    window were resolved when the run was submitted. ``ended_at`` is in UTC ns."""

    of: str
    step: str
    run: RunId
    ended_at: int


class RunEvent(Event, frozen=True):
    STREAM = "run"
    run: RunId


@event("run.submitted", schema=3)
class RunSubmitted(RunEvent, frozen=True):
    """A run is submitted and waits. ``pins`` are the digests of the workflow file, the workcell, each
    module's ``about`` and the whole request, by name. ``anchors`` are the ends of other runs' steps from
    which its windows are counted. ``planned_by`` is the run or experiment whose stream holds its plan (empty:
    its own stream). If the run belongs to a ``campaign``, ``row`` is its row, counted from 0, and ``reads``
    are the steps whose results the campaign's stop rule reads: their index by key. If several modules can do
    a step, ``choices`` lists all its plans, ``plan`` is the first, and ``run.bound`` says which one is used.
    ``due_at`` is the time by which the run should end (UTC ns; 0: none)."""

    plan: str
    workflow: str
    user: str
    experiment: ExperimentId
    priority: int
    payload: dict[str, Any]
    pins: dict[str, str]
    closing: bool = False
    request: str = ""
    anchors: tuple[Anchor, ...] = ()
    planned_by: str = ""
    campaign: CampaignId = CampaignId("")
    row: int | None = None
    reads: dict[str, int] = {}
    choices: tuple[str, ...] = ()
    due_at: int = 0


@event("run.bound")
class RunBound(RunEvent, frozen=True):
    """A run that has several possible plans uses this one from now on. ``modules`` are the chosen modules, by
    the steps' keys. ``planned_by`` is as in ``run.submitted``. ``why`` is the reason if the plan was changed
    after the run had started."""

    plan: str
    modules: dict[str, ModuleName]
    planned_by: str = ""
    why: str = ""


@event("run.started")
class RunStarted(RunEvent, frozen=True):
    """The run's first step is requested."""


@event("run.paused")
class RunPaused(RunEvent, frozen=True):
    """No further step of the run starts until a user resumes it. ``why`` is the reason that the user gave."""

    why: Words = ""


@event("run.resumed")
class RunResumed(RunEvent, frozen=True):
    """The run's steps may start again."""


@event("run.cancelling")
class RunCancelling(RunEvent, frozen=True):
    """The run ends as soon as its actions under way have ended. It is then cancelled, or failed if ``why``
    gives a reason for that. The steps under ``on_cancel`` clear the labware of a cancelled run away, unless
    it is to ``stay``. ``reason`` is the reason that the user gave for cancelling."""

    why: str = ""
    stay: bool = False
    reason: Words = ""


@event("run.leaving")
class RunLeaving(RunEvent, frozen=True):
    """The run was cancelled and its labware is cleared away. These steps under `on_cancel` are needed from
    the present position; all other steps of the plan are left out."""

    steps: tuple[int, ...]


@event("run.completed")
class RunCompleted(RunEvent, frozen=True):
    """All steps of the run are done."""

    steps: int


@event("run.failed")
class RunFailed(RunEvent, frozen=True):
    """The run cannot be completed. ``kind``: software, operational or experiment (the paper's classes of
    failure)."""

    why: str
    kind: str


@event("run.cancelled")
class RunCancelled(RunEvent, frozen=True):
    """The run was cancelled on request. ``why`` is the reason that the user gave, unless ``run.cancelling``
    already has it."""

    why: Words = ""


RunEnd = RunCompleted | RunFailed | RunCancelled
"""The events with which a run ends."""

RUN_ENDS = (RunCompleted.TYPE, RunFailed.TYPE, RunCancelled.TYPE)
"""The types of these events."""


class StepState(msgspec.Struct, omit_defaults=True):
    """The state of one step of a run. ``result`` is the value that later steps read; ``ended_at`` is the time
    of its end (UTC ns). ``breached``: its window was missed. ``retries`` counts its retries, and
    ``retried_at`` is the time of the failure before the last retry (UTC ns). ``trouble`` is the reason of its
    failure, if its recovery has begun."""

    status: StepStatus = StepStatus.PENDING
    ended_at: int | None = None
    result: Any = None
    breached: bool = False
    retries: int = 0
    retried_at: int | None = None
    trouble: str | None = None


class RunStatus(StrEnum):
    """The status of a run. ``LEAVING``: it was cancelled, and its ``on_cancel`` steps clear its labware
    away."""

    QUEUED = "queued"
    ACTIVE = "active"
    CANCELLING = "cancelling"
    LEAVING = "leaving"


class RunState(msgspec.Struct):
    """A run that has not ended. ``steps`` are in the order of its plan; they may be missing while the run
    waits for its start (see ``list_statuses``). ``asked``: a person was asked because it does not begin.
    ``unapproved``: it waits for a second person. ``held``: it waits for an approval. ``choices`` are its
    plans, if there are several; ``plan`` is the one in use, or the first one while the run waits. ``due_at``
    is its due date (UTC ns, 0: none)."""

    id: RunId
    plan: str
    workflow: str
    user: str
    experiment: ExperimentId
    priority: int
    position: int
    submitted_at: int
    closing: bool
    status: RunStatus = RunStatus.QUEUED
    steps: list[StepState] = []
    started_at: int = 0
    paused: bool = False
    why: str = ""
    stay: bool = False
    anchors: tuple[Anchor, ...] = ()
    asked: bool = False
    campaign: CampaignId = CampaignId("")
    unapproved: bool = False
    held: bool = False
    choices: tuple[str, ...] = ()
    due_at: int = 0

    @property
    def has_started(self) -> bool:
        """Whether it was admitted."""
        return self.status is not RunStatus.QUEUED

    @property
    def is_ending(self) -> bool:
        """Whether it was cancelled and only actions under way, or its ``on_cancel`` steps, are still carried
        out."""
        return self.status in (RunStatus.CANCELLING, RunStatus.LEAVING)

    @property
    def statuses(self) -> list[StepStatus]:
        """The status of each step, in the order of its plan; it may be empty while the run waits."""
        return [step.status for step in self.steps]

    def has(self, *statuses: StepStatus) -> bool:
        """Whether any step has one of these statuses."""
        for step in self.steps:  # noqa: SIM110  (asked too often for a generator)
            if step.status in statuses:
                return True
        return False

    def is_breached(self, step: int) -> bool:
        """Whether the window of a step was missed."""
        return bool(self.steps) and self.steps[step].breached


class EndTimes(msgspec.Struct):
    """A completed run of an open experiment: the ends of its steps (UTC ns), by key."""

    workflow: str
    ended_at: dict[str, int]


class Runs(msgspec.Struct):
    """``queue`` maps a waiting class to its runs in order of submission (see ``queue_key``). ``windowed`` are
    the runs with windows that are active, or whose clock another run has started. ``past`` are completed runs
    of open experiments. ``holders`` are the active runs whose plans hold a module. ``named`` counts the run
    ids given out; ``requests`` are the idempotency keys of the last submissions. Indexes by workcell:
    ``in_cell`` has the active runs, ``windowed_in`` the runs of ``windowed``, and ``closings_in`` the
    experiments whose closing workflow uses the workcell. ``ending`` are the active runs that are being
    cancelled or carry out ``on_cancel`` steps. ``choosing`` are the active runs that had several plans."""

    plans: dict[str, PlanState] = {}
    queued: dict[RunId, RunState] = {}
    active: dict[RunId, RunState] = {}
    queue: dict[str, dict[RunId, bool]] = {}
    windowed: dict[RunId, bool] = {}
    past: dict[ExperimentId, dict[RunId, EndTimes]] = {}
    holders: dict[ModuleName, dict[RunId, bool]] = {}
    named: int = 0
    requests: dict[str, RunId] = {}
    in_cell: dict[str, dict[RunId, bool]] = {}
    windowed_in: dict[str, dict[RunId, bool]] = {}
    closings_in: dict[str, dict[ExperimentId, bool]] = {}
    ending: dict[RunId, bool] = {}
    choosing: dict[RunId, bool] = {}

    def list_inside(self, cell: str) -> list[RunState]:
        """The active runs of a workcell, in the order in which they were admitted."""
        return [self.active[name] for name in self.in_cell.get(cell, ())]

    def get(self, run: str) -> RunState | None:
        name = RunId(run)
        return self.active.get(name) or self.queued.get(name)

    def list_holders(self, module: ModuleName) -> list[RunId]:
        """The runs whose plans hold a module now."""
        found = []
        for name in self.holders.get(module, ()):
            run = self.active[name]
            for hold in self.plans[run.plan].plan.holds:
                begun = run.steps[hold.first].status not in (PENDING, SKIPPED)
                if hold.module == module and begun and run.steps[hold.last].status not in SETTLED:
                    found.append(name)
                    break
        return found

    def find_plan_stream(self, plan: str) -> str:
        """The run or experiment whose stream has a plan; empty if the plan is not known now."""
        known = self.plans.get(plan)
        return known.by if known is not None else ""

    def plan_of(self, run: RunState) -> Plan:
        return self.plans[run.plan].plan

    def find_shape(self, run: RunState) -> str:
        """The part of a run's plans on which it depends whether the run may start."""
        if not run.choices:
            return self.plans[run.plan].shape
        return "+".join(self.plans[plan].shape for plan in run.choices)


def list_options(run: RunState) -> list[RunState]:
    """A waiting run, once with each of its plans; a started run only with its own plan."""
    if run.has_started or not run.choices:
        return [run]
    return [run if plan == run.plan else msgspec.structs.replace(run, plan=plan) for plan in run.choices]


def find_open_modules(runs: Runs, run: RunState) -> dict[str, list[ModuleName]]:
    """The modules among which a run can choose, by the steps' keys. A started run has only the chosen
    ones."""
    found: dict[str, list[ModuleName]] = {}
    for option in list_options(run) if run.choices else ():
        for key, module in find_chosen_modules(runs, option).items():
            names = found.setdefault(key, [])
            if module not in names:
                names.append(module)
    return found


def find_chosen_modules(runs: Runs, run: RunState) -> dict[str, ModuleName]:
    """The chosen modules, by the steps' keys, for the steps with different modules in the run's plans."""
    plans = [runs.plans[plan].plan.steps for plan in run.choices]
    steps = runs.plan_of(run).steps
    return {
        step.key: step.module
        for index, step in enumerate(steps)
        if any(other[index].module != step.module for other in plans)
    }


def queue_key(shape: str, run: RunState) -> str:
    """Runs with the same key differ only in their age, as far as their start is concerned."""
    state = (find_holds(run), *list_clocks(run), *([f"due {run.due_at}"] if run.due_at else []))
    return f"{run.priority}\x1f{shape}\x1f{run.user}\x1f{run.experiment}\x1f{run.campaign}\x1f{state}"


def find_holds(run: RunState) -> int:
    """The bits of the reasons in the run itself that keep it from starting: it is paused (1), no second
    person has approved it (2), it waits for an approval (4)."""
    return int(run.paused) + 2 * int(run.unapproved) + 4 * int(run.held)


def list_clocks(run: RunState) -> tuple[int, ...]:
    """The times at which other runs have started this run's clocks (UTC ns)."""
    return tuple(anchor.ended_at for anchor in run.anchors) if run.anchors else ()


def find_anchor(run: RunState, window: Window) -> int | None:
    """The time at which a window's clock started (UTC ns); None if it has not."""
    if window.anchor is not None:
        return run.steps[window.anchor].ended_at if run.steps else None
    meant = (window.of, window.of_step)
    return next((a.ended_at for a in run.anchors if (a.of, a.step) == meant), None)


def fold_plan_recorded(runs: Runs, event: PlanRecorded, at: int) -> None:
    plan = Plan(event.workflow, event.workcell, (), event.feeds, event.files, event.holds)
    runs.plans[event.plan] = PlanState(plan, event.shape, event.steps, event.by)


def fold_plan_steps_recorded(runs: Runs, event: PlanStepsRecorded, at: int) -> None:
    runs.plans[event.plan].add(event.steps)


def fold_run_submitted(runs: Runs, event: RunSubmitted, at: int, position: int) -> None:
    plan = runs.plans[event.plan]
    for one in event.choices or (event.plan,):
        runs.plans[one].uses += 1
    run = make_from(
        RunState,
        event,
        id=event.run,
        position=position,
        submitted_at=at,
        unapproved=any(runs.plans[one].dangers for one in event.choices or (event.plan,)),
    )
    runs.queued[event.run] = run
    if event.anchors:
        _note_window(runs, event.run, plan.plan.workcell)
    runs.queue.setdefault(queue_key(runs.find_shape(run), run), {})[event.run] = True
    runs.named += 1
    if event.request:
        runs.requests[event.request] = event.run
        while len(runs.requests) > REQUESTS_KEPT:
            del runs.requests[next(iter(runs.requests))]


def _leave_queue(runs: Runs, run: RunState) -> None:
    key = queue_key(runs.find_shape(run), run)
    waiting = runs.queue[key]
    del waiting[run.id]
    if not waiting:
        del runs.queue[key]


def fold_run_started(runs: Runs, event: RunStarted, at: int) -> None:
    run = runs.queued[event.run]
    _leave_queue(runs, run)
    del runs.queued[event.run]
    run.status, run.started_at = RunStatus.ACTIVE, at
    run.steps = run.steps or make_first_states(runs.plan_of(run))
    runs.active[event.run] = run
    cell = runs.plan_of(run).workcell
    runs.in_cell.setdefault(cell, {})[event.run] = True
    if runs.plans[run.plan].windowed:
        _note_window(runs, event.run, cell)
    for hold in runs.plan_of(run).holds:
        runs.holders.setdefault(hold.module, {})[event.run] = True
    if run.choices:
        runs.choosing[event.run] = True


def fold_run_bound(runs: Runs, event: RunBound, at: int) -> None:
    run = runs.queued.get(event.run)
    if run is not None:
        run.plan = event.plan
        return
    run = runs.active[event.run]
    for hold in runs.plan_of(run).holds:
        _drop_holder(runs, hold.module, event.run)
    run.plan = event.plan
    for hold in runs.plan_of(run).holds:
        runs.holders.setdefault(hold.module, {})[event.run] = True


def _note_window(runs: Runs, run: RunId, cell: str) -> None:
    runs.windowed[run] = True
    runs.windowed_in.setdefault(cell, {})[run] = True


def list_first_statuses(plan: Plan) -> list[StepStatus]:
    """The first statuses of a plan's steps: the steps for failures and cancellation are dormant."""
    return [PENDING if step.part == MAIN else SKIPPED for step in plan.steps]


def make_first_states(plan: Plan) -> list[StepState]:
    """The first states of a plan's steps."""
    return [StepState(status) for status in list_first_statuses(plan)]


def list_statuses(plan: Plan, run: RunState) -> list[StepStatus]:
    """The status of each step, also of a run that waits for its start."""
    return run.statuses or list_first_statuses(plan)


def find_results(plan: Plan, run: RunState) -> dict[int, Any]:
    """The results that later steps of a run read, by the index of the step."""
    return {i: run.steps[i].result for i in plan.feeds if run.steps and run.steps[i].status == DONE}


def count_in_play(plan: Plan, steps: Sequence[StepStatus]) -> int:
    """The number of a run's steps. Steps for failures and cancellation count only when they are needed."""
    return sum(step.part == MAIN or status != SKIPPED for step, status in zip(plan.steps, steps, strict=True))


def list_rescue_steps(plan: Plan, step: int) -> list[int]:
    """The steps that are carried out when a step has failed and has no retries left."""
    retry = plan.steps[step].retry
    reset = retry.reset if retry is not None else None
    return [index for index, other in enumerate(plan.steps) if other.part == step and index != reset]


def fold_run_paused(runs: Runs, event: RunPaused | RunResumed, at: int) -> None:
    run = runs.queued.get(event.run)
    if run is None:
        runs.active[event.run].paused = isinstance(event, RunPaused)
    else:
        with requeue(runs, run):
            run.paused = isinstance(event, RunPaused)


@contextmanager
def requeue(runs: Runs, run: RunState) -> Iterator[None]:
    """Put a waiting run into its new queue after the block has changed it."""
    _leave_queue(runs, run)
    yield
    runs.queue.setdefault(queue_key(runs.find_shape(run), run), {})[run.id] = True


def fold_run_cancelling(runs: Runs, event: RunCancelling, at: int) -> None:
    run = runs.active[event.run]
    run.status, run.why = RunStatus.CANCELLING, run.why or event.why
    run.stay = run.stay or event.stay
    runs.ending[event.run] = True


def fold_run_leaving(runs: Runs, event: RunLeaving, at: int) -> None:
    run = runs.active[event.run]
    run.status, run.paused = RunStatus.LEAVING, False
    runs.ending[event.run] = True
    for step in run.steps:
        if step.status != DONE:
            step.status = SKIPPED
    for index in event.steps:
        run.steps[index].status = PENDING


def fold_run_ended(runs: Runs, event: RunEnd, at: int) -> None:
    run = runs.active.pop(event.run, None)
    runs.windowed.pop(event.run, None)
    if run is None:
        run = runs.queued[event.run]
        _leave_queue(runs, run)
        del runs.queued[event.run]
    runs.ending.pop(event.run, None)
    runs.choosing.pop(event.run, None)
    for index in (runs.in_cell, runs.windowed_in):
        index.get(runs.plan_of(run).workcell, {}).pop(event.run, None)
    for hold in runs.plan_of(run).holds:
        _drop_holder(runs, hold.module, event.run)
    if isinstance(event, RunCompleted) and run.experiment and not run.closing:
        _remember(runs, run)
    for plan in run.choices or (run.plan,):
        release_plan(runs.plans, plan)


def _drop_holder(runs: Runs, module: ModuleName, run: RunId) -> None:
    holders = runs.holders.get(module, {})
    holders.pop(run, None)
    if not holders:
        runs.holders.pop(module, None)


def _remember(runs: Runs, run: RunState) -> None:
    steps = runs.plan_of(run).steps
    past = runs.past.setdefault(run.experiment, {})
    ends = {p.key: s.ended_at for p, s in zip(steps, run.steps, strict=True) if s.ended_at is not None}
    past[run.id] = EndTimes(run.workflow, ends)
    if len(past) > PAST_KEPT:
        last = {known.workflow: name for name, known in past.items()}
        name = next((name for name, known in past.items() if last[known.workflow] != name), None)
        if name is not None:
            del past[name]


def fold_intervention_requested(runs: Runs, event: InterventionRequested, at: int) -> None:
    if isinstance(event.topic, ClosingWaits):
        runs.queued[RunId(event.run)].asked = True


def fold_experiment_started(runs: Runs, event: ExperimentStarted, at: int) -> None:
    if event.closing:
        plan = runs.plans[event.closing]
        plan.uses += 1
        runs.closings_in.setdefault(plan.plan.workcell, {})[event.experiment] = True


def fold_experiment_ended(runs: Runs, event: ExperimentEnded, at: int) -> None:
    runs.past.pop(event.experiment, None)
    if event.closing:
        cell = runs.plans[event.closing].plan.workcell
        runs.closings_in.get(cell, {}).pop(event.experiment, None)
        release_plan(runs.plans, event.closing)
