"""Creating a lab, starting its kernel, applying workcells, declaring the contents of stations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain

from labos.core.bench import StationState, add_arrival, count_taking, split_item
from labos.core.decide._base import (
    Command,
    Decision,
    InnerCommand,
    Rejection,
    check_recordable,
    decides,
    refuse_hotel,
)
from labos.core.decide.lookups import decides_about, expect_station
from labos.core.decide.shorter import record_shorter_log
from labos.core.effects import Replaces, list_places
from labos.core.ids import SHARED, LabId, ModuleName, StationName, level_key, local, workcell_of
from labos.core.lab import LEAP, KernelStarted, LabCreated, StationsApplied, WorkcellApplied
from labos.core.labware import LabwarePlaced, StationDeclared
from labos.core.model import StationSpec, Workcell
from labos.core.modules import ModulePutBack
from labos.core.registry import Event
from labos.core.resources import LevelSet
from labos.core.shelves import is_in_doubt
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.topics import DiscoveredAction

STATIONS_PER_EVENT = 40


class CreateLab(InnerCommand, frozen=True):
    lab: LabId
    name: str
    pace: float = 1.0


class StartKernel(InnerCommand, frozen=True):
    epoch: int
    version: str


class ApplyWorkcell(Command, frozen=True):
    """Set up a workcell, or change it to a new description. With ``contents``, stations that nobody has
    declared yet get these contents, bottom to top; stations that ``contents`` does not name are empty."""

    workcell: Workcell
    contents: dict[StationName, tuple[str, ...]] | None = None

    def list_parts(self) -> Sequence[Command]:
        return [DeclareStation(name, types) for name, types in (self.contents or {}).items()]


class DeclareStation(Command, frozen=True):
    """Declare the contents of a station: labware types, bottom to top."""

    station: StationName
    contents: tuple[str, ...] = ()


@decides(CreateLab)
def create_lab(state: LabState, command: CreateLab) -> Decision:
    if state.lab.id:
        return Rejection("lab_exists", f"This log already belongs to the lab {state.lab.name!r}.")
    return [LabCreated(command.lab, command.name, command.pace)]


@decides(StartKernel)
def start_kernel(state: LabState, command: StartKernel) -> Decision:
    if command.epoch <= state.lab.epoch:
        return Rejection("old_epoch", f"Epoch {command.epoch} is not above {state.lab.epoch}.")
    return _start(state, command)


def _start(state: LabState, command: StartKernel) -> Iterator[Event]:
    ended, leaps = state.position, state.lab.epoch and command.epoch - state.lab.epoch >= LEAP
    yield KernelStarted(command.epoch, command.version)
    if leaps:
        knows = "may be an older copy"
        yield from record_shorter_log(state, "the restored database", knows, 0, ended)
    # Earlier versions asked a question for each module whose node knew more than the log. These questions
    # become one round.
    asked = state.interventions.open_about(DiscoveredAction)
    for name in dict.fromkeys(ModuleName(question.module) for question in asked):
        module = state.modules.by_name.get(name)
        knows = "knows more, as an earlier question says"
        yield from record_shorter_log(state, str(name), knows, 0, ended, workcell_of(name))
        if module is not None and module.out_of_service:
            yield ModulePutBack(name)
    for question in asked:
        yield question.withdraw("the whole bench is being compared with the log")


@decides(ApplyWorkcell)
def apply_workcell(state: LabState, command: ApplyWorkcell) -> Decision:
    fit = check_recordable(_apply(state, command.workcell))
    if isinstance(fit, Rejection) or command.contents is None:
        return fit
    for spec in command.workcell.places:
        known = state.bench.stations.get(spec.name)
        contents = command.contents.get(spec.name, ())
        wrong = _refuse_contents(spec, contents) or check_recordable([StationDeclared(spec.name, contents)])
        if isinstance(wrong, Rejection) and (known is None or not known.known):
            return wrong
    return chain(fit, _declare_rest(state, command.workcell, command.contents))


def _declare_rest(
    state: LabState, cell: Workcell, contents: dict[StationName, tuple[str, ...]]
) -> Iterator[Event]:
    """Declare the stations that nobody has declared yet and where nothing is under way."""
    for spec in cell.places:
        station = state.bench.stations[spec.name]
        if not station.known and not _refuse_occupied_or_doubtful(state, station):
            yield from _declare(state, station, contents.get(spec.name, ()))


def _apply(state: LabState, cell: Workcell) -> list[Event] | Rejection:
    if state.lab.workcells.get(cell.name) == cell.digest:
        return []
    forbidden = list_obstacles(state, cell)
    if forbidden:
        return forbidden[0]
    events: list[Event] = [make_from(WorkcellApplied, cell)]
    for first in range(0, len(cell.stations), STATIONS_PER_EVENT):
        events.append(StationsApplied(cell.name, cell.stations[first : first + STATIONS_PER_EVENT]))
    gone = sorted(_find_left_out(state, cell)[1])
    for first in range(0, len(gone), STATIONS_PER_EVENT):
        events.append(StationsApplied(cell.name, (), tuple(gone[first : first + STATIONS_PER_EVENT])))
    for spec in cell.modules:
        for resource, capacity in spec.levels.items():
            if level_key(spec.name, resource) not in state.resources.levels:
                events.append(LevelSet(spec.name, resource, capacity, capacity))
    return events


def list_obstacles(state: LabState, cell: Workcell) -> list[Rejection]:
    """All reasons why a workcell cannot be changed to a new description."""
    return [*_find_needed(state, cell), *_find_parking(state, cell), *_find_too_small(state, cell)]


def _find_left_out(state: LabState, cell: Workcell) -> tuple[set[ModuleName], set[StationName]]:
    """The modules and stations that a new description leaves out."""
    modules = {*state.modules.in_cell.get(cell.name, ())} - {module.name for module in cell.modules}
    stations = {*state.bench.in_cell.get(cell.name, ())} - {station.name for station in cell.stations}
    return modules, stations


def _find_needed(state: LabState, cell: Workcell) -> Iterator[Rejection]:
    modules, stations = _find_left_out(state, cell)
    for module in sorted(modules):
        if state.modules.by_name[module].in_flight:
            yield Rejection(
                "module_in_use",
                f"The module {local(module)} is at work and cannot be removed from {cell.name}.",
                "Wait until its action has ended, or cancel the run.",
            )
    for place in sorted(stations):
        station = state.bench.stations[place]
        if station.labware or station.stock or station.expected or place in state.bench.uncertain_at:
            yield _refuse_occupied(state, place, f"cannot be removed from {cell.name}")
    gone: set[str] = {*modules, *stations}
    if not gone:
        return
    runs = [*state.runs.active.values(), *state.runs.queued.values()]
    for digest, plan in state.runs.plans.items():
        needed: set[str] = {step.module for step in plan.plan.steps}
        needed.update(place for step in plan.plan.steps for place in list_places(step.effects))
        refilled = (e.module for s in plan.plan.steps for e in s.effects if isinstance(e, Replaces))
        needed.update(refilled)
        users = ", ".join(run.id for run in runs if run.plan == digest)
        by = f" by {users}" if users else ""
        for name in sorted(gone & needed):
            yield Rejection(
                "plan_in_use",
                f"The workflow {plan.plan.workflow!r} is in use{by} and needs {local(name)}.",
                "Wait until its runs and experiments have ended, or cancel them.",
            )


def _refuse_occupied(state: LabState, place: StationName, so: str) -> Rejection:
    station = state.bench.stations[place]
    if place in state.bench.uncertain_at:
        return Rejection(
            "uncertain",
            f"It is not yet known what stands at {local(place)}, which {so}.",
            "Answer the open question first: labos resolve",
        )
    what = ", ".join(station.labware) or (
        f"a stock of {len(station.stock)}" if station.stock else "an arrival"
    )
    return Rejection(
        "station_occupied",
        f"The station {local(place)} holds {what} and {so}.",
        "Move the labware away first.",
    )


def _find_parking(state: LabState, cell: Workcell) -> Iterator[Rejection]:
    """Parking stations of open experiments must stay: the experiments come back to them."""
    gone = _find_left_out(state, cell)[1]
    for experiment in state.experiments.open.values():
        for place in sorted(gone & set(experiment.parking)):
            yield Rejection(
                "parking_in_use",
                f"The experiment {experiment.id} parks at {local(place)}.",
                "Wait for its end first.",
            )


def _find_too_small(state: LabState, cell: Workcell) -> Iterator[Rejection]:
    hotels = {spec.hotel for spec in cell.stations}
    for spec in cell.stations:
        known = state.bench.stations.get(spec.name)
        full = known is not None and (known.count or is_in_doubt(state.bench, spec.name))
        if known is not None and full and known.spec.kind != spec.kind:
            yield _refuse_occupied(state, spec.name, f"cannot become a {spec.kind}")
        elif full and (spec.name in state.bench.shelves) != (spec.name in hotels):
            yield _refuse_occupied(state, spec.name, "cannot be divided into other shelves")
        elif known is not None and known.count > spec.capacity:
            yield Rejection(
                "station_occupied",
                f"The station {local(spec.name)} holds {known.count}, more than the {spec.capacity} "
                "of its new capacity.",
                "Move the labware away first.",
            )


@decides_about(DeclareStation, expect_station)
def declare_station(state: LabState, command: DeclareStation, station: StationState) -> Decision:
    shelved = refuse_hotel(state, command.station)
    if shelved:
        return shelved
    wrong = _refuse_occupied_or_doubtful(state, station) or _refuse_contents(station.spec, command.contents)
    return wrong or _declare(state, station, command.contents)


def _refuse_occupied_or_doubtful(state: LabState, station: StationState) -> Rejection | None:
    name = station.spec.name
    if station.labware or station.expected:
        return Rejection(
            "station_occupied",
            f"{local(name)} holds {', '.join(station.labware) or 'an arrival under way'}; a "
            "declaration does not overwrite known labware.",
            "Move or remove that labware first.",
        )
    if name in state.bench.uncertain_at or count_taking(state.bench, name):
        return Rejection(
            "uncertain",
            f"It is not yet known what stands at {local(name)}.",
            "First answer the open intervention, or wait for the action.",
        )
    return None


def _refuse_contents(spec: StationSpec, contents: tuple[str, ...]) -> Rejection | None:
    """Why a station cannot hold these contents; None if it can."""
    if len(contents) > spec.capacity:
        return Rejection("too_many", f"{local(spec.name)} holds {spec.capacity}, not {len(contents)}.")
    wrong = next((kind for kind in contents if not spec.admits(split_item(kind)[0])), "")
    if wrong:
        return Rejection("not_accepted", f"{local(spec.name)} {spec.explain_refusal(split_item(wrong)[0])}.")
    return None


def _declare(state: LabState, station: StationState, contents: tuple[str, ...]) -> Iterator[Event]:
    name = station.spec.name
    if station.spec.kind in ("stack", "waste"):
        yield StationDeclared(name, contents)
        return
    yield StationDeclared(name, ())
    for kind, lid in map(split_item, contents):
        plate = LabwarePlaced(state.bench.next_id, "", kind, name, SHARED)
        yield from add_arrival(state.bench, plate, lid)
