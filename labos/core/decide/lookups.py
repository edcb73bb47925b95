"""Finding the thing that a command is about."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

from labos.core.actions import Action
from labos.core.bench import Labware, StationState
from labos.core.bookings import Booking
from labos.core.decide._base import Command, Decider, Decision, Rejection, decides
from labos.core.ids import ExperimentId, Owner, local, split_key
from labos.core.modules import Module, ModuleStatus
from labos.core.open_experiments import Experiment
from labos.core.runs import RunState
from labos.core.state import LabState

T = TypeVar("T")
Find = Callable[[LabState, Any], T | Rejection | None]


def decides_about(
    command: type[Command], find: Find[T]
) -> Callable[[Callable[[LabState, Any, T], Decision]], Decider]:
    """Register the function that decides a command about a thing. It is called with the thing that ``find``
    returns. A rejection is the decision; if there is no such thing (None), nothing follows from the
    command."""

    def register(decider: Callable[[LabState, Any, T], Decision]) -> Decider:
        @decides(command)
        @wraps(decider)
        def decide(state: LabState, request: Any) -> Decision:
            found = find(state, request)
            if isinstance(found, Rejection):
                return found
            return [] if found is None else decider(state, request, found)

        return decide

    return register


def expect_run(state: LabState, command: Any) -> RunState | Rejection:
    found = state.runs.get(command.run)
    return found or Rejection("no_run", f"There is no run {command.run} that has not ended.")


def find_active_run(state: LabState, command: Any) -> RunState | None:
    return state.runs.active.get(command.run)


def expect_experiment(state: LabState, command: Any) -> Experiment | Rejection:
    found = state.experiments.open.get(command.experiment)
    missing = f"There is no experiment {command.experiment} that has not ended."
    return found or Rejection("no_experiment", missing)


def expect_labware(state: LabState, command: Any) -> Labware | Rejection:
    found = state.bench.labware.get(command.labware)
    return found or Rejection("no_labware", f"No labware {command.labware} stands on the bench.")


def expect_module(state: LabState, command: Any) -> Module | Rejection:
    found = state.modules.by_name.get(command.module)
    return found or Rejection("no_module", f"There is no module {local(command.module)}.")


def find_present_module(state: LabState, command: Any) -> Module | None:
    """The module, if it has a node."""
    found = state.modules.by_name.get(command.module)
    return None if found is None or found.status == ModuleStatus.GONE else found


def expect_station(state: LabState, command: Any) -> StationState | Rejection:
    found = state.bench.stations.get(command.station)
    return found or Rejection("no_station", f"There is no station {local(command.station)}.")


def expect_booking(state: LabState, command: Any) -> Booking | Rejection:
    found = state.bookings.open.get(command.booking)
    missing = f"There is no open booking {command.booking}."
    return found or Rejection("no_booking", missing, "List them: labos bookings")


def find_action(state: LabState, command: Any) -> Action | None:
    return state.actions.open.get(command.action)


def find_attempt(state: LabState, command: Any) -> Action | None:
    """The open action, if the command is about its last attempt."""
    found = find_action(state, command)
    return None if found is None or found.attempt != command.attempt else found


def find_living_owner(state: LabState, owner: Owner) -> RunState | Experiment | None:
    """The run or experiment that owns labware, if it has not ended."""
    kind, name = split_key(owner)
    if kind == "run":
        return state.runs.get(name)
    return state.experiments.open.get(ExperimentId(name)) if kind == "experiment" else None


def find_owner(state: LabState, owner: Owner) -> str:
    """The user who owns labware with this owner: the user of a run or of an experiment that has not ended;
    empty if it is shared or has no owner."""
    kind, name = split_key(owner)
    found = find_living_owner(state, owner)
    return name if kind == "user" else found.user if found is not None else ""
