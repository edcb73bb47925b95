"""Which waits an event may end: the keys it touches."""

from __future__ import annotations

from labos.core.actions import (
    ActionFailed,
    ActionReconciled,
    ActionRejected,
    ActionRequested,
    ActionSucceeded,
    ActionUnknown,
)
from labos.core.experiments import ExperimentCancelled, ExperimentClosing, ExperimentEnded
from labos.core.ids import RunId, StationName, workcell_of
from labos.core.interventions import InterventionResolved
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
from labos.core.registry import Event
from labos.core.resources import LevelSet, ResourceReplenished
from labos.core.runs import (
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
from labos.core.shorter import BenchCompared, LogFoundShorter
from labos.core.state import LabState
from labos.core.steps import StepRecovering, StepRetried, StepSkipped, StepUnexpected, WindowBreached
from labos.core.waits import access_key, module_key, run_key, station_key, zone_key
from labos.core.zones import zones_of

EVERYTHING = "*"
"""The key of rare events after which every wait is looked at again."""

BENCH = "bench"
"""The key of events that change what stations and modules there are."""


def cell_key(cell: str) -> str:
    """Touched when anything in a workcell may have become safer."""
    return f"cell:{cell}"


def window_key(run: RunId) -> str:
    """Touched when a run whose clock runs, or is about to, has come further."""
    return f"window:{run}"


def touched(state: LabState, event: Event) -> tuple[str, ...]:
    """The keys that an event touches; called after it was folded."""
    match event:
        case ActionRequested():
            # Safety counts what is in flight as done: others may be safe from now on.
            return (cell_key(workcell_of(event.module)), *_window(state, event.run))
        case LevelSet() | ResourceReplenished():
            # Who could not go on is in nobody's way any more.
            return (module_key(event.module), cell_key(workcell_of(event.module)))
        case ActionSucceeded():
            return (
                module_key(event.module),
                run_key(event.run),
                *_let_go(state, event),
                *_left_zones(state, event),
                *(station_key(name) for name in state.bench.by_module.get(event.module, ())),
                *_window(state, event.run),
            )
        case LabwareMoved():
            return (*_station(state, event.source), *_station(state, event.target))
        case LabwarePlaced():
            return (
                *_station(state, event.station),
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
            return (*_station(state, place), cell_key(workcell_of(place))) if place else ()
        case StationDeclared() | WasteEmptied() | StationLoaded() | StationUnloaded() | StationObserved():
            return (*_station(state, event.station), cell_key(workcell_of(event.station)))
        case RunStarted() | RunSubmitted() | StepRetried():
            return (run_key(event.run),)
        case StepSkipped() | StepRecovering() | StepUnexpected() | RunLeaving():
            # Its way is another one now: others may be safer for it, or hold what it let go of.
            return (EVERYTHING, run_key(event.run))
        case RunCancelling() | WindowBreached():
            return _window(state, event.run)
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
            | RunCompleted()
            | RunFailed()
            | RunCancelled()
            | InterventionResolved()
            | LogFoundShorter()
            | BenchCompared()
        ):
            return (EVERYTHING,)
        case AccessRequested() | AccessGranted() | AccessEnded():
            return (EVERYTHING, access_key(event.name))
        case RunPaused() | RunResumed():
            return (EVERYTHING, run_key(event.run))
        case StartsPaused() | StartsResumed():
            return (EVERYTHING,)
        case ExperimentCancelled() | ExperimentClosing() | ExperimentEnded():
            return (EVERYTHING,)  # what it parks will be cleared away: others' ways may be free now
        case WorkcellApplied() | StationsApplied():
            return (BENCH,)
        case _:
            return ()


def _let_go(state: LabState, event: ActionSucceeded) -> tuple[str, ...]:
    """The modules that a run held until this step by its plan's word."""
    run = state.runs.active.get(event.run)
    holds = state.runs.plan_of(run).holds if run is not None else ()
    freed = [hold.module for hold in holds if hold.last == event.step]
    return (*map(module_key, freed), *(cell_key(workcell_of(module)) for module in freed))


def _left_zones(state: LabState, event: ActionSucceeded) -> tuple[str, ...]:
    """The zones that an arm has come out of; the end of a run wakes everybody anyway."""
    run = state.runs.active.get(event.run)
    if run is None:
        return ()
    effects = state.runs.plan_of(run).steps[event.step].effects
    return tuple(map(zone_key, zones_of(state, event.module, effects)))


def _window(state: LabState, run: RunId) -> tuple[str, ...]:
    return (window_key(run),) if run in state.runs.windowed else ()


def _station(state: LabState, name: StationName) -> tuple[str, ...]:
    """A station, its hotel and its module: what leaves one station may free its module's others."""
    if not name:
        return ()
    station = state.bench.stations.get(name)
    if station is None:
        return (station_key(name),)
    spec = station.spec
    hotel = (station_key(spec.hotel),) if spec.hotel else ()
    return (station_key(name), *hotel, *((module_key(spec.module),) if spec.module else ()))
