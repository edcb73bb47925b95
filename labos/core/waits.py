"""The reasons for which a step can wait, and the changes that may end the wait."""

from __future__ import annotations

import msgspec

from labos.core.bench import StationState
from labos.core.effects import list_arrivals, list_carried
from labos.core.ids import (
    SHARED,
    Owner,
    StationName,
    experiment_owner,
    module_key,
    run_owner,
    station_key,
    user_owner,
    workcell_of,
)
from labos.core.reasons import AnyReason
from labos.core.runs import RunState
from labos.core.state import LabState


class Wait(msgspec.Struct, frozen=True):
    """Why a step cannot start. ``on`` are the keys whose change may end the wait; ``until`` is a time (UTC
    ns) that ends it by itself."""

    reason: AnyReason
    on: tuple[str, ...] = ()
    until: int | None = None

    @property
    def blocked(self) -> bool:
        """Whether a person has to act, or a device has to come back. Otherwise the wait ends by itself."""
        return not self.reason.PASSES

    @property
    def code(self) -> str:
        """The name of the reason's type in tables and answers."""
        return self.reason.code

    @property
    def names(self) -> tuple[str, ...]:
        """The names in the reason."""
        return self.reason.names


def list_party(run: RunState) -> tuple[Owner, ...]:
    """The owners whose labware a run may use, the nearest first."""
    owners = [run_owner(run.id)]
    if run.experiment:
        owners.append(experiment_owner(run.experiment))
    return (*owners, user_owner(run.user), SHARED)


def list_keys_until_free(state: LabState, place: StationName) -> tuple[str, ...]:
    """The keys of a station and of the modules at work there. An arm that only changed its grip there, or a
    module that worked on the labware there, changes no other key."""
    bench = state.bench
    standing = {bench.labware[name].moving for name in bench.stations[place].labware}
    modules = [
        action.module
        for action in state.actions.list_in_cell(workcell_of(place))
        if action.id in standing
        or place in list_arrivals(action.effects)
        or (
            place in bench.shelves
            and any(bench.find_planned_place(p) == place for p in list_arrivals(action.effects))
        )
        or any(what.stock == place for what in list_carried(action.effects))
    ]
    return (station_key(place), *(module_key(module) for module in modules))


def describe_occupants(state: LabState, station: StationState) -> str:
    return ", ".join(station.labware) or ("an arrival under way" if station.expected else "stock")
