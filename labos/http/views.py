"""The lab's state as an answer of the API."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from typing import Annotated, Any

import msgspec
import structlog

from labos.core.actions import Action
from labos.core.bench import StationState
from labos.core.decide.access import list_in_motion, list_perhaps_in_motion
from labos.core.ids import CampaignId, ModuleName, RunId, local
from labos.core.interventions import Intervention
from labos.core.model import PlanStep
from labos.core.modules import Module, ModuleStatus
from labos.core.runs import (
    DONE,
    FAILED,
    IN_FLIGHT,
    UNKNOWN,
    RunState,
    count_in_play,
    find_open_modules,
    list_statuses,
)
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.topics import Choice
from labos.core.waits import Wait
from labos.http.notes import Notes
from labos.http.parts import LabKernel
from labos.planning.due import find_time_left
from labos.planning.forecast import find_setup_in_progress
from labos.planning.obstacle import explain_wait
from labos.runtime.followed import FoldedLab
from labos.services.interventions import describe_whereabouts
from labos.services.waits import list_unknown_reasons

QUEUED_SHOWN = 100

OldName = Annotated[
    str,
    msgspec.Meta(
        description="the same as `module`, as it was called", extra_json_schema={"deprecated": True}
    ),
]
"""A deprecated field for older programs."""

_log = structlog.get_logger(__name__)


class AccessView(msgspec.Struct, frozen=True):
    """A person's access to a workcell. ``moving`` are the modules that still move, ``perhaps_moving`` those
    that may still move."""

    by: str
    why: str
    granted: bool
    moving: list[str]
    perhaps_moving: list[str]


class LabInfo(msgspec.Struct, frozen=True):
    """The lab itself. ``workcells`` are the digests of its workcells."""

    id: str
    name: str
    pace: float
    epoch: int
    simulated: bool
    workcells: dict[str, str]
    access: dict[str, AccessView]


class ModuleAction(msgspec.Struct, frozen=True):
    """An action that a module carries out; ``since`` in UTC nanoseconds."""

    action: str
    run: str
    since: int
    status: str


class ProcessView(msgspec.Struct, frozen=True):
    """The process of a module's node, where the lab started it."""

    state: str
    pid: int
    starts: int


class CalibrationView(msgspec.Struct, frozen=True):
    """The last calibration of a module, or of ``what`` of it; ``at`` in UTC nanoseconds."""

    what: str
    certificate: str
    until: str
    file: str
    by: str
    at: int


class ModuleView(msgspec.Struct, frozen=True):
    """A module. ``back_at``: when it is back in service by itself (UTC nanoseconds; 0: when a person puts it
    back)."""

    module: str
    name: OldName
    driver: str
    model: str
    status: str
    problem: str
    out_of_service: bool
    back_at: int
    simulated: bool
    variables: dict[str, Any]
    doing: list[ModuleAction]
    process: ProcessView | None
    calibrations: list[CalibrationView]


class StationView(msgspec.Struct, frozen=True):
    """A station. ``stock`` is the number of pieces without ids on a stack, ``level`` the number in a waste;
    ``hotel`` is the hotel that it belongs to as a shelf."""

    name: str
    kind: str
    capacity: int
    known: bool
    labware: list[str]
    stock: int
    level: int
    hotel: str


class LabwareView(msgspec.Struct, frozen=True):
    """A piece of labware. ``maybe`` are the places where it may be, ``on`` the plate it lies on, ``moving``
    the action that moves it."""

    id: str
    type: str
    station: str
    maybe: list[str]
    lid: str
    on: str
    owner: str
    moving: str
    variables: dict[str, Any]
    barcode: str


class StepView(msgspec.Struct, frozen=True):
    """A step in progress: since when (UTC nanoseconds), and how long it will still take (lab seconds), by its
    nominal duration; null if its outcome is unknown."""

    step: int
    key: str
    module: str
    action: str
    state: str
    since: int
    left_s: float | None


class WaitView(msgspec.Struct, frozen=True):
    """Why a step does not start, in one sentence."""

    step: int
    key: str
    code: str
    why: str
    blocked: bool


class RunView(msgspec.Struct, frozen=True):
    """A run that has not ended: its progress, its present action, and why it does not continue. ``modules``
    are, by the step's key, the modules between which the workflow leaves a choice; after the run has started,
    only the chosen one. ``due_at`` is its due date (0: none); ``late_by_s`` is how late it would end if
    nothing delayed it from now on: negative if it would be early, null without a due date."""

    id: str
    workflow: str
    workcell: str
    user: str
    experiment: str
    priority: int
    status: str
    closing: bool
    submitted_at: int
    started_at: int
    steps: int
    done: int
    failed: int
    doing: list[StepView]
    waits: list[WaitView]
    modules: dict[str, list[str]] = {}
    due_at: int = 0
    late_by_s: float | None = None


class QuestionView(msgspec.Struct, frozen=True):
    """A question of the lab to a person, with the possible answers."""

    id: str
    kind: str
    text: str
    now: str
    choices: tuple[Choice, ...]
    run: str
    module: str
    requested_at: int
    due_at: int
    overdue: bool


class ExperimentView(msgspec.Struct, frozen=True):
    id: str
    name: str
    user: str
    status: str
    runs: list[str]
    started_at: int


class LevelView(msgspec.Struct, frozen=True):
    level: float
    capacity: float


class LabView(msgspec.Struct, frozen=True):
    """``position``: the position of the log that this state shows. ``now``: the kernel's time (UTC
    nanoseconds). ``runs``: active runs and the first 100 queued runs. ``queued``: the number of queued runs.
    ``resources`` are by ``workcell/module:resource``."""

    lab: LabInfo
    position: int
    now: int
    modules: list[ModuleView]
    stations: list[StationView]
    labware: list[LabwareView]
    runs: list[RunView]
    queued: int
    interventions: list[QuestionView]
    experiments: list[ExperimentView]
    resources: dict[str, LevelView]


def make_lab_view(kernel: LabKernel, notes: Notes, *, waits: bool, hidden: frozenset[CampaignId]) -> LabView:
    """The present state of the lab, without the runs of the campaigns ``hidden``."""
    state, now = kernel.state, kernel.clock.now_ns()
    runs = [run for run in state.runs.active.values() if run.campaign not in hidden]
    runs += islice((run for run in state.runs.queued.values() if run.campaign not in hidden), QUEUED_SHOWN)
    flying = {(action.run, action.step): action for action in state.actions.open.values()}
    return LabView(
        lab=_make_lab_info(state, notes.simulated),
        position=state.position,
        now=now,
        modules=[
            _make_module_view(name, module, state, notes) for name, module in state.modules.by_name.items()
        ],
        stations=[_make_station_view(name, station) for name, station in state.bench.stations.items()],
        labware=[
            make_from(LabwareView, item, station=local(item.station), maybe=list(map(local, item.maybe)))
            for item in state.bench.labware.values()
        ],
        runs=[run_view(kernel, run, now, flying, waits=waits) for run in runs],
        queued=len(state.runs.queued),
        interventions=[make_question_view(state, asked) for asked in state.interventions.open.values()],
        experiments=[
            make_from(ExperimentView, item, runs=list(item.runs)) for item in state.experiments.open.values()
        ],
        resources={
            key: LevelView(level.level, level.capacity) for key, level in state.resources.levels.items()
        },
    )


def _make_lab_info(state: LabState, simulated: bool) -> LabInfo:
    access = {
        cell: make_from(
            AccessView,
            access,
            moving=list(list_in_motion(state, cell)),
            perhaps_moving=list(list_perhaps_in_motion(state, cell)),
        )
        for cell, access in state.lab.access.items()
    }
    return make_from(
        LabInfo, state.lab, simulated=simulated, workcells=dict(state.lab.workcells), access=access
    )


def _make_module_view(name: str, module: Module, state: LabState, notes: Notes) -> ModuleView:
    process = notes.supervised.get(name)
    doing = [state.actions.open[action] for action in module.in_flight if action in state.actions.open]
    problem = module.out_of_service or notes.rejected.get(name, "") or module.error
    if process is not None and process.state == "quarantined":
        problem = f"given up after {process.failures} failures: {process.why}"
    return ModuleView(
        module=name,
        name=name,
        driver=module.spec.driver,
        model=module.spec.model,
        status="BUSY" if module.status == ModuleStatus.IDLE and module.busy else module.status,
        problem=problem,
        out_of_service=bool(module.out_of_service),
        back_at=state.modules.back_at.get(ModuleName(name), 0),
        simulated=module.simulated,
        variables=module.values,
        doing=[ModuleAction(a.name, a.run, a.requested_at, a.status) for a in doing],
        process=None if process is None else make_from(ProcessView, process),
        calibrations=list_calibrations(module),
    )


def list_calibrations(module: Module) -> list[CalibrationView]:
    """The last calibrations of a module, one for each ``what``."""
    return [make_from(CalibrationView, one, what=what) for what, one in sorted(module.calibrations.items())]


def make_question_view(state: LabState, question: Intervention) -> QuestionView:
    """A question of the lab to a person, with the possible answers."""
    return make_from(
        QuestionView,
        question,
        now=describe_whereabouts(state, question),
        choices=tuple(question.choices),
        module=local(question.module),
    )


def _make_station_view(name: str, station: StationState) -> StationView:
    return make_from(
        StationView,
        station.spec,
        name=name,
        known=station.known,
        labware=list(station.labware),
        stock=len(station.stock),
        level=station.level,
    )


def run_view(
    kernel: LabKernel, run: RunState, now: int, flying: Mapping[tuple[RunId, int], Action], *, waits: bool
) -> RunView:
    """A run that has not ended. ``flying`` are the actions in flight by run and step."""
    state = kernel.state
    plan = state.runs.plan_of(run)
    steps = list_statuses(plan, run)
    return make_from(
        RunView,
        run,
        workcell=plan.workcell,
        status="paused" if run.paused else run.status,
        steps=count_in_play(plan, steps),
        done=sum(step == DONE for step in steps),
        failed=sum(step == FAILED for step in steps),
        doing=[
            _make_step_view(state, flying.get((run.id, index)), index, plan.steps[index], step, now)
            for index, step in enumerate(steps)
            if step in (IN_FLIGHT, UNKNOWN)
        ],
        waits=list_wait_views(kernel, run, now) if waits else [],
        modules={key: list(map(local, names)) for key, names in find_open_modules(state.runs, run).items()},
        late_by_s=round((now + find_time_left(state, run) - run.due_at) / 1e9, 1) if run.due_at else None,
    )


def _make_step_view(
    state: LabState, action: Action | None, index: int, step: PlanStep, status: str, now: int
) -> StepView:
    left_s = None
    if action is not None and action.status != "unknown":
        gone_s = (now - action.requested_at) / 1e9 * state.lab.pace
        takes_s = step.duration_s + find_setup_in_progress(state, action) / 1e9 * state.lab.pace
        left_s = round(max(takes_s - gone_s, 0.0), 1)
    return StepView(
        step=index,
        key=step.key,
        module=local(step.module),
        action=step.action,
        state=status,
        since=action.requested_at if action is not None else 0,
        left_s=left_s,
    )


def list_wait_views(kernel: LabKernel, run: RunState, now: int) -> list[WaitView]:
    """Why a run does not continue, in one sentence for each ready step. Only the kernel itself knows the
    orders that it has found."""
    plan = kernel.state.runs.plan_of(run)

    def view(step: int, wait: Wait) -> WaitView:
        why = explain_wait(kernel.scheduler.safety, kernel.state, run, wait)
        return WaitView(step, plan.steps[step].key, wait.code, why, wait.blocked)

    if kernel.suspended:
        return [_view_failed_planning(f"No step is started, because planning fails: {kernel.suspended}")]
    try:
        waits = kernel.scheduler.list_waits(kernel.state, run, now)
        if not waits and isinstance(kernel, FoldedLab):
            unknown = list_unknown_reasons(kernel.state, run, now)
            return [WaitView(r.step, plan.steps[r.step].key, "sooner_after", r.why, False) for r in unknown]
        return [view(step, wait) for step, wait in waits]
    except Exception as error:  # the rest of the view is still useful
        _log.exception("wait_not_explained", run=run.id)
        return [
            _view_failed_planning(f"LabOS cannot say what it waits for: {error!r}. This is a fault of LabOS.")
        ]


def _view_failed_planning(why: str) -> WaitView:
    return WaitView(0, "", "planning_failed", why, True)
