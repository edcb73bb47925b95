"""Finds the runs that have to move before a run can continue. No reservation for that run may stop them.

These are the runs whose labware is in the run's way, and those that its next motion would trap. The runs that
are in the way of these are included too."""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

from labos.core.algebra import check_effect
from labos.core.effects import Carrying, Claims, Consumes, Effect, Needs, Requires, list_carried, name_hand
from labos.core.ids import ModuleName, Owner, RunId, StationName, run_owner, split_key
from labos.core.model import PlanStep
from labos.core.rules import examine
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.core.waits import Wait, list_party
from labos.planning.forecast import find_pending_before, is_pending, takes_from
from labos.planning.layout import find_destination, list_labware_in
from labos.planning.safety import Safety

ANYWHERE = StationName("")


class Helpers(msgspec.Struct):
    """``runs`` have to move first. So do the runs that carry away the labware in ``parked`` (place, owner).
    ``in_vain``: the run cannot reach its end whichever runs move, so no room has to be kept for it. ``times``
    are when the helpers may change, because a step no longer has to wait (UTC ns)."""

    runs: dict[RunId, bool] = {}
    parked: dict[tuple[StationName, Owner], bool] = {}
    in_vain: bool = False
    times: list[int] = []

    def include(self, state: LabState, run: RunState) -> bool:
        """Whether a run is a helper; if ``in_vain``, every run is."""
        if self.in_vain or run.id in self.runs:
            return True
        owners = list_party(run)
        return any(
            owner in owners and (place == ANYWHERE or _carries_from(state, run, place))
            for place, owner in self.parked
        )


def find_helpers(state: LabState, run: RunState, chain: Iterable[int], now: int, safety: Safety) -> Helpers:
    """The runs that have to move first so that these steps of a run can be carried out."""
    search = _Search(state, now, safety, state.runs.plan_of(run).workcell)
    search.add_blockers(run, set(chain))
    return search.found


class _Search:
    def __init__(self, state: LabState, now: int, safety: Safety, cell: str) -> None:
        self.state, self.now, self.safety, self.cell = state, now, safety, cell
        self.found = Helpers()
        self._seen: set[tuple[RunId, StationName]] = set()
        self._standing: dict[StationName, list[Owner]] = {}
        for item in list_labware_in(state, cell):
            place = find_destination(state.bench, item)
            if place:
                self._standing.setdefault(place, []).append(item.owner)
        for action in state.actions.list_in_cell(cell):
            for what in list_carried(action.effects):
                if what.stock:
                    target = state.bench.find_planned_place(what.target)
                    self._standing.setdefault(target, []).append(run_owner(action.run))

    def add_blockers(self, run: RunState, steps: set[int]) -> None:
        """Add all runs that prevent these steps of a run."""
        plan = self.state.runs.plan_of(run)
        for index in sorted(steps):
            step = plan.steps[index]
            if step.exclusive:
                self.add_holders(step.module, run)
            clearing = _Clearing(self, run, step)
            for effect in step.effects:
                check_effect(clearing, effect)
        self._add_trapped(run, steps)

    def is_full(self, place: StationName) -> bool:
        station = self.state.bench.stations[place]
        count = len(self._standing.get(place, ())) + len(station.stock)
        return station.spec.kind != "waste" and count >= station.spec.capacity

    def add_occupants(self, place: StationName, run: RunState) -> None:
        own = run_owner(run.id)
        for owner in self._standing.get(place, ()):
            if owner != own:
                self._add(place, owner)

    def add_holders(self, name: ModuleName, run: RunState) -> None:
        """Add the runs that keep a module: by labware in it, by a hold, or by a door away from rest."""
        bench, mine = self.state.bench, list_party(run)
        for place in bench.by_module.get(name, ()):
            if bench.stations[place].spec.claim:
                for owner in self._standing.get(place, ()):
                    if owner not in mine:
                        self._add(place, owner)
        for holder in self.state.runs.list_holders(name):
            if holder != run.id:
                self._add(ANYWHERE, run_owner(holder))
        module = self.state.modules.by_name[name]
        for left in module.list_away_from_rest().values():
            by = RunId(left.by)
            if by != run.id and by in self.state.runs.active:
                self._add(ANYWHERE, run_owner(by))

    def add_setpoint_holders(self, name: ModuleName, effect: Claims, run: RunState) -> None:
        """Add the runs that hold a setpoint at another value: they have to release it."""
        held = self.state.modules.by_name[name].setpoints.get(effect.setpoint)
        if held is not None and held.value != effect.value:
            for holder in held.holders:
                if holder != run.id:
                    self._add(ANYWHERE, run_owner(RunId(holder)))

    def _add(self, place: StationName, owner: Owner) -> None:
        """Labware of an owner has to leave a place. ANYWHERE: its run has to do all its remaining steps."""
        kind, name = split_key(owner)
        if kind == "run":
            self._add_run(RunId(name), place)
            return
        if (place, owner) in self.found.parked:
            return
        self.found.parked[place, owner] = True
        for run in self.state.runs.list_inside(self.cell):
            if owner in list_party(run) and _carries_from(self.state, run, place):
                self._add_run(run.id, place)

    def _add_run(self, name: RunId, place: StationName) -> None:
        run = self.state.runs.active.get(name)
        if run is None or (name, place) in self._seen:
            return
        self._seen.add((name, place))
        self.found.runs[name] = True
        plan = self.state.runs.plan_of(run)
        pending = [index for index in range(len(plan.steps)) if is_pending(run, index)]
        leaving = next((index for index in pending if takes_from(plan.steps[index], place)), None)
        steps = pending if place == ANYWHERE or leaving is None else find_pending_before(run, plan, leaving)
        self.add_blockers(run, set(steps))

    def _add_trapped(self, run: RunState, steps: set[int]) -> None:
        """Add the runs that the next motions of this run would trap."""
        for index in sorted(steps):
            found = examine(self.state, run, index, self.now)
            if isinstance(found, Wait):
                if found.until is not None:
                    self.found.times.append(found.until)
                continue
            if run.has_started and not self.safety.changes_anything(self.state, run, index):
                continue
            trapped = self.safety.list_trapped(self.state, run, index, only_asking=True)
            self.found.in_vain |= trapped == [run.id]
            for name in trapped:
                if split_key(name)[0] == "experiment":
                    self._add(ANYWHERE, Owner(name))
                else:
                    self._add_run(RunId(name), ANYWHERE)


def _carries_from(state: LabState, run: RunState, place: StationName) -> bool:
    steps = state.runs.plan_of(run).steps
    return any(is_pending(run, index) and takes_from(step, place) for index, step in enumerate(steps))


class _Clearing:
    """A store for one step of a run (see ``core.algebra``). Its checks report no obstacle, but they add the
    runs that have to move first."""

    def __init__(self, search: _Search, run: RunState, step: PlanStep) -> None:
        self.search, self.run, self.step = search, run, step

    def stock(self, what: Carrying, stack: StationName) -> None:
        self.search.add_occupants(stack, self.run)

    def check_presence(self, what: Carrying, place: StationName) -> None:
        """No run is added: whether others' labware on a hotel or a nest is in the way is not known."""

    def check_fits(self, what: Carrying) -> None:
        """No run is added: a run whose labware does not fit is blocked, whichever runs move."""

    def check_hand(self, what: Carrying) -> None:
        self.search.add_occupants(name_hand(self.step.module), self.run)

    def check_entry(self, what: Carrying, place: StationName) -> None:
        spec = self.search.state.bench.stations[place].spec
        if spec.claim and spec.module:
            self.search.add_holders(spec.module, self.run)

    def check_room(self, what: Effect, place: StationName) -> None:
        if self.search.is_full(place):
            self.search.add_occupants(place, self.run)

    def check_labware(self, needs: Needs) -> None:
        """No run is added: which run brings the labware is not known."""

    def check_value(self, requires: Requires) -> None:
        """No run is added: which run changes the value is not known."""

    def check_setpoint(self, claims: Claims) -> None:
        self.search.add_setpoint_holders(self.step.module, claims, self.run)

    def check_amount(self, consumes: Consumes) -> None:
        """No run is added: a person has to fill it up."""
