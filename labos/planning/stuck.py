"""Why a run is blocked (here: stuck): it can reach its end only after a person or a device acts.

Stuck runs are obstacles for all other runs: no run waits until they move (see ``safety``). A stuck run that
is not admitted yet does not block other runs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from labos.core import reasons
from labos.core.bench import Labware, find_variable
from labos.core.binding import check_module, find_unfit_labware, find_unreserved, find_usable, is_same
from labos.core.booked import find_begun_booking
from labos.core.effects import Carrying, Needs, Requires, Sets, list_places
from labos.core.ids import (
    LabwareId,
    ModuleName,
    StationName,
    module_key,
    run_key,
    run_owner,
    station_key,
    zone_key,
)
from labos.core.model import MAIN, PlanStep
from labos.core.rules import check_starts_allowed, find_person_wait
from labos.core.runs import IN_FLIGHT, SETTLED, UNKNOWN, RunState, list_statuses
from labos.core.state import LabState
from labos.core.topics import FailedStep
from labos.core.waits import Wait
from labos.core.watching import find_unwatched
from labos.core.zones import find_barred_zones, find_zones
from labos.planning.forecast import list_ready_steps


def find_block(state: LabState, run: RunState) -> Wait | None:
    """The first reason why a run is blocked, whatever other runs do; None if it is not blocked."""
    plan = state.runs.plan_of(run)
    wait = find_person_wait(state, run)
    if wait is not None:
        return wait
    if run.has(UNKNOWN):
        key = plan.steps[run.statuses.index(UNKNOWN)].key
        return Wait(reasons.Outcome(key), (run_key(run.id),))
    for _, wait in find_questions(state, run):
        return wait
    states = list_statuses(plan, run)
    left = [step for step, status in zip(plan.steps, states, strict=True) if status not in SETTLED]
    return (
        _check_halted(state, run, left)
        or _check_lost(state, run)
        or _check_modules(state, left)
        or find_begun_booking(state, run, left)
        or _check_stopped_devices(state, run, left)
        or _check_barred(state, run, left)
        or find_unwatched(state, left)
        or _check_supplies(state, run)
        or _check_labware(state, run)
    )


def find_questions(state: LabState, run: RunState) -> list[tuple[int, Wait]]:
    """The failed steps, by index, for which a person has to decide what happens, with their waits."""
    questions = state.interventions.find_by_run(run.id)
    if not questions:
        return []
    steps = state.runs.plan_of(run).steps
    indices = [(q.topic.step, q.id) for q in questions if isinstance(q.topic, FailedStep)]
    return [(index, Wait(reasons.Asked(steps[index].key, name))) for index, name in indices]


def _check_halted(state: LabState, run: RunState, left: Sequence[PlanStep]) -> Wait | None:
    for step in left if state.lab.paused else ():
        wait = check_starts_allowed(state, run, step)
        if wait is not None:
            return wait
    return None


def _check_lost(state: LabState, run: RunState) -> Wait | None:
    for item in state.bench.list_owned(run_owner(run.id)):
        if item.maybe:
            return Wait(reasons.Lost(item.id), tuple(map(station_key, item.maybe)))
    return None


def _check_modules(state: LabState, left: Sequence[PlanStep]) -> Wait | None:
    recovered = {step.module for step in left if step.recovers}
    for name in dict.fromkeys(step.module for step in left):
        module = state.modules.by_name.get(name)
        if module is None:
            return Wait(reasons.NoModule(name), (module_key(name),))
        wait = check_module(module, recovers=name in recovered)
        if wait is not None:
            return wait
    return None


def _check_stopped_devices(state: LabState, run: RunState, left: Sequence[PlanStep]) -> Wait | None:
    """The wait for a device whose node went away during an action, if the run still needs its stations."""
    for name in state.modules.in_cell.get(state.runs.plan_of(run).workcell, ()):
        module = state.modules.by_name[name]
        if module.cut_off and any(reaches_into(state, name, list_places(s.effects)) for s in left):
            return check_module(module)
    return None


def reaches_into(state: LabState, module: ModuleName, reached: Iterable[StationName]) -> bool:
    """Whether one of these places belongs to a module, and the module can block an arm that reaches in."""
    specs = [state.bench.stations[place].spec for place in reached if place in state.bench.stations]
    return any(spec.module == module and not spec.stands_apart for spec in specs)


def _check_barred(state: LabState, run: RunState, left: Sequence[PlanStep]) -> Wait | None:
    """The wait for a zone that a run still has to enter, if another arm has stopped in it."""
    zones = find_barred_zones(state, state.runs.plan_of(run).workcell)
    for step in left if zones else ():
        if step.exclusive and not step.recovers:
            for zone in find_zones(state, step.module, step.effects):
                other = zones.get(zone, step.module)
                if other != step.module:
                    return Wait(reasons.ZoneBarred(other, zone), (zone_key(zone), module_key(other)))
    return None


def _check_supplies(state: LabState, run: RunState) -> Wait | None:
    """The wait for a resource, if less is left than one of the run's remaining steps needs."""
    used = state.runs.plans[run.plan].uses_up
    states = list_statuses(state.runs.plan_of(run), run) if used else ()
    for index, module, resource, amount in used:
        if states[index] in (*SETTLED, IN_FLIGHT):
            continue
        if state.resources.find(module, resource) is None:
            continue
        if (find_unreserved(state, module, resource) or 0.0) < amount:
            return Wait(reasons.UsedUp(module, resource), (module_key(module),))
    return None


def _check_labware(state: LabState, run: RunState) -> Wait | None:
    """The wait for labware, if each step whose turn it is waits for labware that does not fit. The place does
    not accept its type, the arm cannot hold it, it lies the wrong way round, or it is sealed or lidded. None
    while a step is in flight."""
    if not run.has_started:
        return _check_labware_ahead(state, run)
    if run.has(IN_FLIGHT):
        return None
    steps = state.runs.plan_of(run).steps
    waits = [find_unfit_labware(state, run, steps[index]) for index in list_ready_steps(state, run)]
    return waits[0] if waits and all(waits) else None


def _check_labware_ahead(state: LabState, run: RunState) -> Wait | None:
    """The wait for labware that a run will use after its admission, if the labware does not meet the
    requirements of a step. Steps under a condition are left out."""
    way = _LabwareAhead(state, run)
    for step in state.runs.plan_of(run).steps:
        if step.part == MAIN and step.when is None:
            wait = way.find_misfit(step)
            if wait is not None:
                return wait
    return None


class _LabwareAhead:
    """The labware that a run will use, where it stands now, even if it is lent to another run; and what the
    run will have changed of it."""

    def __init__(self, state: LabState, run: RunState) -> None:
        self.state, self.run = state, run
        self._at: dict[StationName, Labware | None] = {}
        self._changed: set[tuple[LabwareId, str]] = set()

    def find_misfit(self, step: PlanStep) -> Wait | None:
        """The wait for labware that does not meet a step's requirements; None if there is none. Notes what
        the step changes."""
        subject: Labware | None = None
        for effect in step.effects:
            match effect:
                case Carrying():
                    subject = self._find(effect.plate_at or effect.source) if effect.stands else None
                    wait = (
                        self._check_variable(subject, "lidded", effect.lid == "off") if effect.lid else None
                    )
                    if wait is not None:
                        return wait
                    self._carry(effect, subject)
                case Needs():
                    nests = self.state.bench.by_module.get(step.module, [])
                    places = [effect.station] if effect.station else nests
                    brought = any(place in self._at and self._at[place] is None for place in places)
                    found = (self._find(place) for place in places)
                    subject = None if brought else next(filter(None, found), None)
                case Requires(of="labware"):
                    wait = self._check_variable(subject, effect.variable, effect.value)
                    if wait is not None:
                        return wait
                case Sets(of="labware") if subject is not None:
                    self._changed.add((subject.id, effect.variable))
        return None

    def _find(self, place: StationName) -> Labware | None:
        if place not in self._at:
            self._at[place] = find_usable(self.state, self.run, place, lent=True)
        return self._at[place]

    def _carry(self, what: Carrying, subject: Labware | None) -> None:
        if what.lid:
            self._changed |= {(subject.id, "lidded")} if subject is not None else set()
            self._at[what.target if what.lid == "off" else what.source] = None
            return
        self._at[what.target], self._at[what.source] = subject, None

    def _check_variable(self, item: Labware | None, variable: str, wanted: Any) -> Wait | None:
        if (
            item is None
            or (item.id, variable) in self._changed
            or is_same(find_variable(item, variable), wanted)
        ):
            return None
        return Wait(reasons.Unfit(item.id, variable, str(wanted)), (station_key(item.station),))
