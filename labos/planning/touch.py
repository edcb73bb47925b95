"""The keys that an event touches. The event may end the waits for these keys."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

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
"""The key of rare events after which every wait is checked again."""


BENCH, STANDING, OVER, BOOKING = "bench", "standing", "over", "booking"
RUN, BEGUN, DUE, WINDOW = "run", "begun", "due", "window"
"""The kinds of keys: the part of a key before the colon."""


class Touched(msgspec.Struct, frozen=True):
    """The sorted ``keys`` of events, and the names in them by kind (``named``). ``runs`` are the runs that
    keys name as touched themselves. Under ``EVERYTHING`` are the workcells in which every wait is checked
    again. With ``whole``, every wait of the lab is checked again."""

    keys: list[str] = []
    named: dict[str, list[str]] = {}
    runs: dict[str, RunId] = {}
    whole: bool = False


def sort_keys(keys: Iterable[str]) -> Touched:
    """These keys, each once, sorted and by kind."""
    ordered = sorted(set(keys))
    named: dict[str, list[str]] = {}
    runs: dict[str, RunId] = {}
    for key in ordered:
        if key.startswith(EVERYTHING):
            if key != EVERYTHING:
                named.setdefault(EVERYTHING, []).append(key.removeprefix(EVERYTHING))
            continue
        kind, name = split_key(key)
        named.setdefault(kind, []).append(name)
        if kind == RUN and name:
            runs[key] = RunId(name)
    return Touched(ordered, named, runs, EVERYTHING in ordered)


def every_wait_key(cell: str) -> str:
    """The key of events after which every wait in a workcell is checked again."""
    return f"{EVERYTHING}{cell}"


def bench_key(cell: str) -> str:
    """The key of events that change the stations and modules of a workcell, or shares and groups of users."""
    return f"{BENCH}:{cell}"


def cell_key(cell: str) -> str:
    """Touched when a start in a workcell may have become safe."""
    return f"cell:{cell}"


def near_key(cell: str) -> str:
    """Touched by every event in a workcell that touches any key."""
    return f"near:{cell}"


def labware_key(cell: str) -> str:
    """Touched when the place or the owner of labware in a workcell may have changed."""
    return f"{STANDING}:{cell}"


def list_cell_keys(cell: str) -> tuple[str, ...]:
    """The keys of events that may end any wait in a workcell and may have moved labware there."""
    return (every_wait_key(cell), near_key(cell), labware_key(cell))


def started_key(name: str) -> str:
    """Touched when an experiment begins, or a person is asked a question."""
    return f"{BEGUN}:{name}"


def ended_key(name: str) -> str:
    """Touched when a run or an experiment has ended, or a question is answered. Every wait in its workcell is
    checked again."""
    return f"{OVER}:{name}"


def due_key(name: str) -> str:
    """Touched when the deadline of an action or a question may have changed."""
    return f"{DUE}:{name}"


def is_key_of_all(key: str) -> bool:
    """Whether a key stands for all waits of a workcell or of the lab."""
    return key.startswith((EVERYTHING, ended_key("")))


def window_key(run: RunId) -> str:
    """Touched when a run with windows starts or ends a step, misses a window or is cancelled."""
    return f"{WINDOW}:{run}"


def find_touched_keys(state: LabState, event: Event) -> tuple[str, ...]:
    """The keys that an event touches. Call this after the event was folded."""
    cell = _find_cell(state, event)
    keys = _find_touched_keys(state, event, every_wait_key(cell) if cell else EVERYTHING)
    if isinstance(event, ActionEvent) and keys:
        keys = (*keys, due_key(event.action))
    if state.shares.digest and isinstance(event, _LESS_IS_TO_COME):
        keys = (*keys, QUOTA_KEY)
    if not cell or not keys:
        return keys
    stays = _leaves_labware_alone(state, event)
    return (*keys, near_key(cell)) if stays else (*keys, near_key(cell), labware_key(cell))


def _find_cell(state: LabState, event: Event) -> str:
    """The workcell in which an event happens; empty if it is not known."""
    if isinstance(event, (WorkcellApplied, StationsApplied)):  # a union takes twice as long
        return event.name
    for field in _list_place_fields(type(event)):
        name = getattr(event, field)
        if name:
            return workcell_of(StationName(name))
    labware = state.bench.labware.get(getattr(event, "labware", LabwareId("")))
    if labware is not None:
        places = (labware.station, *labware.maybe)
        if any(places):
            return workcell_of(next(filter(None, places)))
    return find_cell_of_run(state, getattr(event, "run", ""))


_PLACES = ("module", "station", "source", "where", "stack")
"""The fields of events that name a module or a station."""


@cache
def _list_place_fields(kind: type[Event]) -> tuple[str, ...]:
    """The fields of an event of this type that name a module or a station."""
    return tuple(field for field in _PLACES if field in kind.__struct_fields__)


def find_cell_of_run(state: LabState, run: str) -> str:
    """The workcell of a run that has not ended; empty if there is no such run."""
    known = state.runs.get(run)
    return state.runs.plan_of(known).workcell if known is not None else ""


def _leaves_labware_alone(state: LabState, event: Event) -> bool:
    """Whether labware stands where it stood before the event, and belongs to the same owners. A run that
    starts counts as labware of its experiment."""
    match event:
        case RunSubmitted() | ActionSucceeded():
            return True  # the changes that an action made to labware follow as separate events
        case ActionRequested():
            return not event.effects
        case RunStarted():
            return not state.runs.active[event.run].experiment
        case _:
            return False


_LESS_IS_TO_COME = (
    ActionSucceeded,
    ActionFailed,
    ActionRejected,
    ActionReconciled,
    StepSkipped,
    RunCancelling,
    RunLeaving,
)
"""After these events, a started run may need less of its user's quota than before."""


def _find_touched_keys(state: LabState, event: Event, everything: str) -> tuple[str, ...]:
    """The keys that an event touches. ``everything`` is the key of all waits of its workcell or the lab."""
    match event:
        case ActionRequested():
            # Safety counts an action in flight as done. So other starts may be safe from now on.
            return (cell_key(workcell_of(event.module)), *_list_window_keys(state, event.run))
        case ActionSucceeded():
            # Places were kept in case the action failed. Now they are free, so other starts may be safe.
            return (
                module_key(event.module),
                cell_key(workcell_of(event.module)),
                run_key(event.run),
                *_list_released_modules(state, event),
                *_list_left_zones(state, event),
                *(station_key(name) for name in state.bench.by_module.get(event.module, ())),
                *_list_window_keys(state, event.run),
            )
        case LevelSet() | ResourceReplenished() | SetpointReleased():
            # A run that was blocked may continue, so it is no obstacle to other runs any more.
            return (module_key(event.module), cell_key(workcell_of(event.module)))
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
        case LabwareChanged() | LabwareHandedOver():
            labware = state.bench.labware.get(event.labware)
            place = labware.station if labware is not None else StationName("")
            return (*_list_station_keys(state, place), cell_key(workcell_of(place))) if place else ()
        case StationDeclared() | WasteEmptied() | StationLoaded() | StationUnloaded() | StationObserved():
            return (*_list_station_keys(state, event.station), cell_key(workcell_of(event.station)))
        case RunBound():
            # Only a run that has started is bound with ``why``. Its path is a different one now.
            return (everything, run_key(event.run)) if event.why else ()
        case RunStarted() | RunSubmitted() | StepRetried():
            return (run_key(event.run),)
        case StepSkipped() | StepRecovering() | StepUnexpected() | RunLeaving():
            # The path of the run has changed: other starts may be safe, or may hold what the run released.
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
            cell = find_cell_of_run(state, event.subject)  # it may make other starts safe or unsafe
            return (every_wait_key(cell), run_key(RunId(event.subject))) if cell else ()
        case RunPaused() | RunResumed() | RunApproved():
            return (everything, run_key(event.run))
        case StartsPaused() | StartsResumed():
            return _list_target_keys(state, event.target)
        case ExperimentCancelled() | ExperimentClosing():
            # Its parked labware will be cleared away, so the paths of other runs may be free.
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
    """The keys of the workcell in which starts are paused; of the lab if the target is in no workcell."""
    cell = workcell_of(ModuleName(target))
    return list_cell_keys(cell) if cell in state.lab.workcells else (EVERYTHING,)


def _list_booking_keys(state: LabState, event: BookingEvent) -> tuple[str, ...]:
    """The keys of the workcell of a booking; of all workcells if the booking is not known any more. No keys
    if it only begins soon."""
    if isinstance(event, BookingNeared):
        return ()
    known = state.bookings.open.get(event.booking)
    target = event.target if isinstance(event, BookingTerms) else known.target if known is not None else ""
    cells = [workcell_of(ModuleName(target))] if target else list(state.lab.workcells)
    return tuple(key for cell in cells for key in (*list_cell_keys(cell), booking_key(cell)))


def _list_experiment_keys(state: LabState, name: ExperimentId) -> tuple[str, ...]:
    """The keys of the workcells in which an experiment has runs or closes; of the lab if it is not known."""
    known = state.experiments.open.get(name)
    if known is None:
        return (EVERYTHING,)
    cells = dict.fromkeys(
        [find_cell_of_closing(state, name), *(find_cell_of_run(state, run) for run in known.runs)]
    )
    return tuple(key for cell in cells if cell for key in list_cell_keys(cell))


def find_cell_of_closing(state: LabState, experiment: str) -> str:
    """The workcell of an experiment's closing workflow; empty if it has none."""
    known = state.experiments.open.get(ExperimentId(experiment))
    return state.runs.plans[known.closing].plan.workcell if known is not None and known.closing else ""


def _list_released_modules(state: LabState, event: ActionSucceeded) -> tuple[str, ...]:
    """The keys of the modules that a plan holds for its run until this step, and of their workcells."""
    run = state.runs.active.get(event.run)
    holds = state.runs.plan_of(run).holds if run is not None else ()
    freed = [hold.module for hold in holds if hold.last == event.step]
    return (*map(module_key, freed), *(cell_key(workcell_of(module)) for module in freed))


def _list_left_zones(state: LabState, event: ActionSucceeded) -> tuple[str, ...]:
    """The keys of the zones that an arm has left. If the run has ended, none: all waits are checked then."""
    run = state.runs.active.get(event.run)
    if run is None:
        return ()
    effects = state.runs.plan_of(run).steps[event.step].effects
    return tuple(map(zone_key, find_zones(state, event.module, effects)))


def _list_window_keys(state: LabState, run: RunId) -> tuple[str, ...]:
    return (window_key(run),) if run in state.runs.windowed else ()


def _list_station_keys(state: LabState, name: StationName) -> tuple[str, ...]:
    """The keys of a station, its hotel and its module. Labware that leaves may free the module's other
    stations."""
    if not name:
        return ()
    station = state.bench.stations.get(name)
    if station is None:
        return (station_key(name),)
    spec = station.spec
    hotel = (station_key(spec.hotel),) if spec.hotel else ()
    return (station_key(name), *hotel, *((module_key(spec.module),) if spec.module else ()))
