"""The stations that an observer checks before a motion counts as successful.

A station may name an observer. With ``always``, it is asked after every motion that takes labware from there
or puts it there. With ``on_doubt``, it is asked after motions of a module that failed, was stopped or had an
unknown outcome, until one motion was confirmed. It is also asked after motions that try a newly taught pose.
"""

from __future__ import annotations

from collections.abc import Iterable

from labos.core import reasons
from labos.core.actions import Action
from labos.core.effects import AnyEffect, list_carried
from labos.core.ids import StationName, module_key
from labos.core.model import PlanStep
from labos.core.modules import ModuleStatus
from labos.core.state import LabState
from labos.core.waits import Wait


def list_end_stations(effects: Iterable[AnyEffect]) -> tuple[StationName, ...]:
    """The stations from which labware is taken, and those where it is put down at the end."""
    places = [place for what in list_carried(effects) for place in (what.emptied, what.filled)]
    return tuple(dict.fromkeys(filter(None, places)))


def list_watched(state: LabState, action: Action) -> tuple[StationName, ...]:
    """The stations that observers check when the module of an action reports success. Work that a person has
    done by hand needs no check."""
    bench = state.bench
    if not bench.watched:
        return ()
    run = state.runs.active.get(action.run)
    if run is not None and state.runs.plan_of(run).steps[action.step].by_person:
        return ()
    module = state.modules.by_name[action.module]
    flight = module.in_flight.get(action.id)
    doubtful = module.doubted or (flight is not None and bool(flight.proving))
    return tuple(
        place
        for place in list_end_stations(action.effects)
        if place in bench.watched and (doubtful or bench.stations[place].spec.verify == "always")
    )


def find_unwatched(state: LabState, steps: Iterable[PlanStep]) -> Wait | None:
    """A station of these steps' motions that is always observed, and whose observer cannot be asked."""
    bench = state.bench
    for step in steps if bench.watched else ():
        for place in () if step.by_person else list_end_stations(step.effects):
            if place not in bench.watched or bench.stations[place].spec.verify != "always":
                continue
            observer = bench.stations[place].spec.observer
            module = state.modules.by_name.get(observer)
            if module is None or module.out_of_service or module.status == ModuleStatus.GONE:
                how = "out of service" if module is not None and module.out_of_service else "GONE"
                return Wait(reasons.Unwatched(place, observer, how), (module_key(observer),))
    return None
