"""Which run keeps a module from others: by its labware there, by a hold of its plan, or by a door or lid that
it left away from rest."""

from __future__ import annotations

from labos.core.effects import list_arrivals
from labos.core.ids import ModuleName, Owner, RunId, StationName, run_owner, workcell_of
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.core.waits import list_party


def find_other_holder(state: LabState, name: ModuleName, run: RunState) -> str:
    """The owner who keeps a module from this run: by labware at a station that claims the module, by a hold
    of a plan, or by a door or lid left away from rest. Empty if there is none."""
    claimant = find_other_claimant(state, name, list_party(run)) if name in state.bench.by_module else ""
    return claimant or find_other_keeper(state, name, run)


def find_other_keeper(state: LabState, name: ModuleName, run: RunState) -> str:
    """The owner whose plan keeps the module, or who left a door or lid away from rest. Empty if there is
    none."""
    return find_holder_by_plan(state, name, run) or find_door_leaver(state, name, run)


def find_user_meanwhile(state: LabState, place: StationName, run: RunState) -> str:
    """Labware, an owner or an action that occupies a station, or its module, after this run's labware was
    seen to have left it. Empty if there is none."""
    station = state.bench.stations[place]
    if station.full:
        return ", ".join(station.labware) or "something on its way there"
    if not station.spec.claim:
        return ""
    name = station.spec.module
    for action in state.actions.list_in_cell(workcell_of(name)) if state.modules.by_name[name].busy else ():
        if action.module == name and action.exclusive and action.run != run.id:
            return run_owner(action.run)
    return find_other_holder(state, name, run)


def find_other_claimant(state: LabState, name: ModuleName, allowed: tuple[Owner, ...]) -> str:
    """The owner of labware that claims the module: it stands at a claiming station, is on its way there, or
    may stand there. Owners in ``allowed`` do not count."""
    bench = state.bench
    for station in bench.by_module.get(name, ()):
        place = bench.stations[station]
        if place.spec.claim:
            for labware in place.labware:
                owner = bench.labware[labware].owner
                if owner not in allowed:
                    return owner or "nobody"
            for lost in map(bench.labware.__getitem__, bench.lost) if station in bench.uncertain_at else ():
                if station in lost.maybe and lost.owner not in allowed:
                    return lost.owner or "nobody"
            for action in state.actions.list_in_cell(workcell_of(name)) if place.expected else ():
                if station in list_arrivals(action.effects) and run_owner(action.run) not in allowed:
                    return run_owner(action.run)
    return ""


def find_holder_by_plan(state: LabState, name: ModuleName, run: RunState) -> str:
    """The other run whose plan keeps the module."""
    if name not in state.runs.holders:
        return ""
    return next((run_owner(holder) for holder in state.runs.list_holders(name) if holder != run.id), "")


def find_door_leaver(state: LabState, name: ModuleName, run: RunState) -> str:
    """The other run that left a door or lid of the module away from rest."""
    module = state.modules.by_name[name]
    for left in module.list_away_from_rest().values():
        if left.by != run.id and left.by in state.runs.active:
            return run_owner(RunId(left.by))
    return ""
