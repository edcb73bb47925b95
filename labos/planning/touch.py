"""Which waits an event may end: the keys it touches."""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

from labos.core.actions import (
    ActionEvent,
    ActionFailed,
    ActionReconciled,
    ActionRejected,
    ActionRequested,
    ActionSucceeded,
    ActionUnknown,
)
from labos.core.approvals import ApprovalGiven, RunApproved
from labos.core.booked import booking_key
from labos.core.bookings import BookingEvent, BookingNeared, BookingTerms
from labos.core.experiments import ExperimentCancelled, ExperimentClosing, ExperimentEnded, ExperimentStarted
from labos.core.ids import (
    ExperimentId,
    LabwareId,
    ModuleName,
    RunId,
    StationName,
    access_key,
    module_key,
    run_key,
    split_key,
    station_key,
    workcell_of,
    zone_key,
)
from labos.core.interventions import InterventionOverdue, InterventionRequested, InterventionResolved
from labos.core.lab import (
    AccessEnded,
    AccessGranted,
    AccessRequested,
    StartsPaused,
    StartsResumed,
    StationsApplied,
    WorkcellApplied,
)
from labos.core.labware import (
    LabwareChanged,
    LabwareHandedOver,
    LabwareMoved,
    LabwareObserved,
    LabwarePlaced,
    LabwareRemoved,
    LabwareUncertain,
    StationDeclared,
    StationLoaded,
    StationObserved,
    StationUnloaded,
    WasteEmptied,
)
from labos.core.modules import (
    EmergencyStopped,
    ModulePutBack,
    ModuleTakenOut,
    NodeJoined,
    NodeLeft,
    NodeStateChanged,
    SetpointReleased,
    VariableSet,
)
from labos.core.quotas import QUOTA_KEY
from labos.core.registry import Event
from labos.core.resources import LevelSet, ResourceReplenished
from labos.core.runs import (
    RunBound,
    RunCancelled,
    RunCancelling,
    RunCompleted,
    RunFailed,
    RunLeaving,
    RunPaused,
    RunResumed,
    RunStarted,
    RunSubmitted,
)
from labos.core.shares import SharesApplied
from labos.core.shorter import BenchCompared, LogFoundShorter
from labos.core.state import LabState
from labos.core.steps import StepRecovering, StepRetried, StepSkipped, StepUnexpected, WindowBreached
from labos.core.suggestions import OrderSuggested
from labos.core.users import GroupRemoved, MemberAdded, MemberRemoved
from labos.core.zones import find_zones

EVERYTHING = "*"
"""The key of rare events after which every wait is looked at again."""


BENCH, STANDING, OVER, BOOKING = "bench", "standing", "over", "booking"
RUN, BEGUN, DUE, WINDOW = "run", "begun", "due", "window"
"""Kinds of keys, which stand before the colon."""


class Touched(msgspec.Struct, frozen=True):
    """Keys of events, sorted, and the names in them by kind. Those of ``EVERYTHING`` are the workcells of
    which every wait is looked at again; with ``whole``, those of the whole lab are."""

    keys: list[str] = []
    named: dict[str, list[str]] = {}
    whole: bool = False


def sort_keys(keys: Iterable[str]) -> Touched:
    """These keys, each once."""
    ordered = sorted(set(keys))
    named: dict[str, list[str]] = {}
    for key in ordered:
        if not key.startswith(EVERYTHING):
            kind, name = split_key(key)
            named.setdefault(kind, []).append(name)
        elif key != EVERYTHING:
            named.setdefault(EVERYTHING, []).append(key.removeprefix(EVERYTHING))
    return Touched(ordered, named, EVERYTHING in ordered)


def every_wait_key(cell: str) -> str:
    """The key of events after which every wait in a workcell is looked at again."""
    return f"{EVERYTHING}{cell}"


def bench_key(cell: str) -> str:
    """The key of events that change what stations and modules there are in a workcell."""
    return f"{BENCH}:{cell}"


def cell_key(cell: str) -> str:
    """Touched when anything in a workcell may have become safer."""
    return f"cell:{cell}"


def near_key(cell: str) -> str:
    """Touched by everything that happens in a workcell."""
    return f"near:{cell}"


def labware_key(cell: str) -> str:
    """Touched when labware may stand elsewhere in a workcell, or belong to somebody else."""
    return f"{STANDING}:{cell}"


def list_cell_keys(cell: str) -> tuple[str, ...]:
    """The keys of everything that may have happened in a workcell."""
    return (every_wait_key(cell), near_key(cell), labware_key(cell))


def started_key(name: str) -> str:
    """Touched when an experiment has begun, or a person is asked."""
    return f"{BEGUN}:{name}"


def ended_key(name: str) -> str:
    """Touched when a run or an experiment has ended, or a question is answered: every wait in its workcell
    is looked at again."""
    return f"{OVER}:{name}"


def due_key(name: str) -> str:
    """Touched when the time that an action or a question has may be another than it was."""
    return f"{DUE}:{name}"


def is_key_of_all(key: str) -> bool:
    """Whether a key stands for all waits of a workcell, or of the lab."""
    return key.startswith((EVERYTHING, ended_key("")))


def window_key(run: RunId) -> str:
    """Touched when a run whose clock runs, or is about to, has come further."""
    return f"{WINDOW}:{run}"


def find_touched_keys(state: LabState, event: Event) -> tuple[str, ...]:
    """The keys that an event touches; called after it was folded."""
    cell = _find_cell(state, event)
    keys = _find_touched_keys(state, event, every_wait_key(cell) if cell else EVERYTHING)
    if isinstance(event, ActionEvent) and keys:
        keys = (*keys, due_key(event.action))
    if isinstance(event, _LESS_IS_TO_COME) and state.shares.digest:
        keys = (*keys, QUOTA_KEY)
    if not cell or not keys:
        return keys
    # What an action did to labware follows as events of their own.
    stays = isinstance(event, ActionSucceeded) or (isinstance(event, ActionRequested) and not event.effects)
    return (*keys, near_key(cell)) if stays else (*keys, near_key(cell), labware_key(cell))


def _find_cell(state: LabState, event: Event) -> str:
    """The workcell in which an event happens; empty if it cannot be told."""
    if isinstance(event, WorkcellApplied | StationsApplied):
        return event.name
    for field in _PLACES:
        name = getattr(event, field, "")
        if name:
            return workcell_of(StationName(name))
    labware = state.bench.labware.get(getattr(event, "labware", LabwareId("")))
    if labware is not None:
        places = (labware.station, *labware.maybe)
        if any(places):
            return workcell_of(next(filter(None, places)))
    return find_cell_of_run(state, getattr(event, "run", ""))


_PLACES = ("module", "station", "source", "where", "stack")
"""Fields of events that name a module or a station."""


def find_cell_of_run(state: LabState, run: str) -> str:
    """The workcell of a run that has not ended; empty if there is none."""
    known = state.runs.get(run)
    return state.runs.plan_of(known).workcell if known is not None else ""


_LESS_IS_TO_COME = (
    ActionSucceeded,
    ActionFailed,
    ActionRejected,
    ActionReconciled,
    StepSkipped,
    RunCancelling,
    RunLeaving,
)
"""After these a run that is under way may have less of its user's quota than before."""


def _find_touched_keys(state: LabState, event: Event, everything: str) -> tuple[str, ...]:
    """The keys that an event touches; ``everything`` is the key of its workcell."""
    match event:
        case ActionRequested():
            # Safety counts what is in flight as done: others may be safe from now on.
            return (cell_key(workcell_of(event.module)), *_list_window_keys(state, event.run))
        case LevelSet() | ResourceReplenished():
            # Who could not go on is in nobody's way any more.
            return (module_key(event.module), cell_key(workcell_of(event.module)))
        case ActionSucceeded():
            # What is in flight keeps its place in case it fails: others may be safe from now on.
            return (
                module_key(event.module),
                cell_key(workcell_of(event.module)),
                run_key(event.run),
                *_list_released_modules(state, event),
                *_list_left_zones(state, event),
                *(station_key(name) for name in state.bench.by_module.get(event.module, ())),
                *_list_window_keys(state, event.run),
            )
        case LabwareMoved():
            return (*_list_station_keys(state, event.source), *_list_station_keys(state, event.target))
        case LabwarePlaced():
            return (
                *_list_station_keys(state, event.station),
                station_key(event.stack),
                cell_key(workcell_of(event.station)),
            )
        case VariableSet():
            return (module_key(event.module),)
        case SetpointReleased():
            return (module_key(event.module), cell_key(workcell_of(event.module)))
        case LabwareChanged() | LabwareHandedOver():
            labware = state.bench.labware.get(event.labware)
            place = labware.station if labware is not None else StationName("")
            return (*_list_station_keys(state, place), cell_key(workcell_of(place))) if place else ()
        case StationDeclared() | WasteEmptied() | StationLoaded() | StationUnloaded() | StationObserved():
            return (*_list_station_keys(state, event.station), cell_key(workcell_of(event.station)))
        case RunBound():
            # Of one that was let in, its way is another one now.
            return (everything, run_key(event.run)) if event.why else ()
        case RunStarted() | RunSubmitted() | StepRetried():
            return (run_key(event.run),)
        case StepSkipped() | StepRecovering() | StepUnexpected() | RunLeaving():
            # Its way is another one now: others may be safer for it, or hold what it let go of.
            return (everything, run_key(event.run))
        case RunCompleted() | RunFailed() | RunCancelled():
            return (ended_key(event.run), QUOTA_KEY) if state.shares.digest else (ended_key(event.run),)
        case SharesApplied() | GroupRemoved() | MemberAdded() | MemberRemoved():
            return (EVERYTHING, QUOTA_KEY, *map(bench_key, state.lab.workcells))
        case OrderSuggested():
            return list_cell_keys(event.workcell)
        case InterventionRequested():
            return (started_key(event.intervention),)
        case InterventionOverdue():
            return (due_key(event.intervention),)
        case InterventionResolved():
            return (ended_key(event.intervention),)
        case ExperimentStarted():
            return (started_key(event.experiment),)
        case RunCancelling() | WindowBreached():
            return _list_window_keys(state, event.run)
        case (
            ActionFailed()
            | ActionRejected()
            | ActionReconciled()
            | ActionUnknown()
            | LabwareRemoved()
            | LabwareObserved()
            | LabwareUncertain()
            | NodeJoined()
            | NodeLeft()
            | NodeStateChanged()
            | ModuleTakenOut()
            | ModulePutBack()
            | EmergencyStopped()
            | LogFoundShorter()
            | BenchCompared()
        ):
            return (everything,)
        case AccessRequested() | AccessGranted() | AccessEnded():
            return (*list_cell_keys(event.name), access_key(event.name))
        case ApprovalGiven():
            cell = find_cell_of_run(state, event.subject)  # others may be safe or not with it
            return (every_wait_key(cell), run_key(RunId(event.subject))) if cell else ()
        case RunPaused() | RunResumed() | RunApproved():
            return (everything, run_key(event.run))
        case StartsPaused() | StartsResumed():
            return _list_target_keys(state, event.target)
        case ExperimentCancelled() | ExperimentClosing():
            # What it parks will be cleared away: others' ways may be free now.
            return _list_experiment_keys(state, event.experiment)
        case ExperimentEnded():
            return (ended_key(event.experiment),)
        case BookingEvent():
            return _list_booking_keys(state, event)
        case WorkcellApplied() | StationsApplied():
            return (bench_key(event.name), everything, access_key(event.name))
        case _:
            return ()


def _list_target_keys(state: LabState, target: str) -> tuple[str, ...]:
    """Where starts are paused: on a module, in a workcell; else everywhere."""
    cell = workcell_of(ModuleName(target))
    return list_cell_keys(cell) if cell in state.lab.workcells else (EVERYTHING,)


def _list_booking_keys(state: LabState, event: BookingEvent) -> tuple[str, ...]:
    """The workcell in which something is booked; everywhere, where the booking is not known any more."""
    if isinstance(event, BookingNeared):
        return ()
    known = state.bookings.open.get(event.booking)
    target = event.target if isinstance(event, BookingTerms) else known.target if known is not None else ""
    cells = [workcell_of(ModuleName(target))] if target else list(state.lab.workcells)
    return tuple(key for cell in cells for key in (*list_cell_keys(cell), booking_key(cell)))


def _list_experiment_keys(state: LabState, name: ExperimentId) -> tuple[str, ...]:
    """The workcells in which an experiment has runs, or in which it closes."""
    known = state.experiments.open.get(name)
    if known is None:
        return (EVERYTHING,)
    cells = dict.fromkeys(
        [find_cell_of_closing(state, name), *(find_cell_of_run(state, run) for run in known.runs)]
    )
    return tuple(key for cell in cells if cell for key in list_cell_keys(cell))


def find_cell_of_closing(state: LabState, experiment: str) -> str:
    """The workcell in which an experiment closes; empty if it has no closing workflow."""
    known = state.experiments.open.get(ExperimentId(experiment))
    return state.runs.plans[known.closing].plan.workcell if known is not None and known.closing else ""


def _list_released_modules(state: LabState, event: ActionSucceeded) -> tuple[str, ...]:
    """The modules that a run held until this step by its plan's word."""
    run = state.runs.active.get(event.run)
    holds = state.runs.plan_of(run).holds if run is not None else ()
    freed = [hold.module for hold in holds if hold.last == event.step]
    return (*map(module_key, freed), *(cell_key(workcell_of(module)) for module in freed))


def _list_left_zones(state: LabState, event: ActionSucceeded) -> tuple[str, ...]:
    """The zones that an arm has come out of; the end of a run wakes everybody anyway."""
    run = state.runs.active.get(event.run)
    if run is None:
        return ()
    effects = state.runs.plan_of(run).steps[event.step].effects
    return tuple(map(zone_key, find_zones(state, event.module, effects)))


def _list_window_keys(state: LabState, run: RunId) -> tuple[str, ...]:
    return (window_key(run),) if run in state.runs.windowed else ()


def _list_station_keys(state: LabState, name: StationName) -> tuple[str, ...]:
    """A station, its hotel and its module: what leaves one station may free its module's others."""
    if not name:
        return ()
    station = state.bench.stations.get(name)
    if station is None:
        return (station_key(name),)
    spec = station.spec
    hotel = (station_key(spec.hotel),) if spec.hotel else ()
    return (station_key(name), *hotel, *((module_key(spec.module),) if spec.module else ()))
