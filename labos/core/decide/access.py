"""A person reaches into a workcell: no action starts there, arms are parked, and actions in flight end."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import msgspec

from labos.core.actions import ActionStatus
from labos.core.decide._base import (
    Command,
    Decision,
    InnerCommand,
    Rejection,
    decides,
    list_possible,
    refuse_hotel,
)
from labos.core.decide.by_hand import withdraw_answered
from labos.core.decide.cancelling import cancel_all
from labos.core.decide.runs import SubmitRun, plan_digest, submit_run
from labos.core.decide.work import find_work
from labos.core.ids import SHARED, LabwareId, StationName, local, workcell_of
from labos.core.lab import AccessEnded, AccessGranted, AccessRequested
from labos.core.labware import GONE, LabwareObserved, LabwarePlaced, LabwareRemoved, StationDeclared
from labos.core.modules import ModuleStatus
from labos.core.registry import Event
from labos.core.repeated import record_repeat
from labos.core.state import LabState
from labos.core.words import Words


class ReportedChange(msgspec.Struct, frozen=True):
    """A person's report of a station: ``what`` is ``empty``, the id of labware that the log knows, or the
    type of fresh labware."""

    station: StationName
    what: str


class RequestAccess(Command, frozen=True):
    """Stop all starts in a workcell except those of the runs ``parking``, which bring its arms to rest. If a
    parking run cannot be submitted, access is granted without it."""

    workcell: str
    by: str
    why: Words = ""
    parking: tuple[SubmitRun, ...] = ()

    def list_parts(self) -> Sequence[Command]:
        return self.parking


class GrantAccess(InnerCommand, frozen=True):
    """Planning has nothing left to start: grant access if nothing moves."""

    workcell: str


class EndAccess(Command, frozen=True):
    """The access has ended, and the person reports the changes at the stations."""

    workcell: str
    by: str
    note: Words = ""
    changes: tuple[ReportedChange, ...] = ()


def list_in_motion(state: LabState, cell: str) -> list[str]:
    """The modules of a workcell that may move. Planned work of a person does not count, and neither do
    actions with an unknown outcome."""
    moving = [
        local(action.module)
        for action in state.actions.list_in_cell(cell)
        if action.status != ActionStatus.UNKNOWN and find_work(state, action) is None
    ]
    busy = [
        local(name)
        for name, module in state.modules.list_in_cell(cell)
        if module.status == ModuleStatus.BUSY and not module.in_flight
    ]
    return [*moving, *busy]


def list_perhaps_in_motion(state: LabState, cell: str) -> list[str]:
    """The modules of a workcell that may still be in motion because the outcome of their action is unknown.
    The person with access has to take care of them."""
    actions = state.actions.list_in_cell(cell)
    unknown = [local(action.module) for action in actions if action.status == ActionStatus.UNKNOWN]
    return list(dict.fromkeys(unknown))


@decides(RequestAccess)
def request_access(state: LabState, command: RequestAccess) -> Decision:
    cell = command.workcell
    if cell not in state.lab.workcells:
        return Rejection("no_workcell", f"This lab has no workcell {cell!r}.")
    inside = state.lab.access.get(cell)
    if inside is not None:
        if inside.by == command.by:
            return record_repeat(cell, "access", command.why)
        return Rejection(
            "occupied",
            f"{inside.by} already reaches into {cell}{(f' ({inside.why})' if inside.why else '')}.",
            f"Wait until that has ended: labos access {cell} --done",
        )
    parking = [run for run in command.parking if not isinstance(submit_run(state, run), Rejection)]
    plans = tuple(dict.fromkeys(plan_digest(run.plan) for run in parking))
    requested = AccessRequested(cell, command.by, command.why, plans)
    submitted = (event for run in parking for event in list_possible(submit_run(state, run)))
    return chain([requested], submitted)


@decides(GrantAccess)
def grant_access(state: LabState, command: GrantAccess) -> Decision:
    access = state.lab.access.get(command.workcell)
    if access is None or access.granted or list_in_motion(state, command.workcell):
        return []
    # An arm that could not be parked stays where it is.
    runs = [*state.runs.active.values(), *state.runs.queued.values()]
    parking = [run.id for run in runs if run.plan in access.parking]
    return chain([AccessGranted(command.workcell)], cancel_all(state, parking))


@decides(EndAccess)
def end_access(state: LabState, command: EndAccess) -> Decision:
    cell = command.workcell
    if cell not in state.lab.access:
        return Rejection("no_access", f"Nobody reaches into {cell!r}.")
    events: list[Event] = [AccessEnded(cell, command.by, command.note)]
    left: dict[StationName, list[LabwareId]] = {}
    kept = {change.what for change in command.changes}
    fresh = 0
    # Labware that was taken away makes room for labware that was put there.
    for change in sorted(command.changes, key=lambda change: change.what != "empty"):
        found = _apply_change(state, cell, command.by, change, left, fresh, kept)
        if isinstance(found, Rejection):
            return found
        events += found
        fresh += any(isinstance(event, LabwarePlaced) for event in found)
    return [*withdraw_answered(state, events, command.by), *events]


def _apply_change(
    state: LabState,
    cell: str,
    by: str,
    change: ReportedChange,
    left: dict[StationName, list[LabwareId]],
    fresh: int,
    kept: set[str],
) -> list[Event] | Rejection:
    """The events of one change. ``left`` maps stations to the labware there after the earlier changes.
    ``fresh`` counts the earlier changes that brought new labware. ``kept`` is the labware that any change
    names: it has not left the bench."""
    station = state.bench.stations.get(change.station)
    if station is None or workcell_of(change.station) != cell:
        return Rejection("no_station", f"{cell} has no station {local(change.station)}.")
    shelved = refuse_hotel(state, change.station)
    if shelved:
        return shelved
    if change.station in state.bench.uncertain_at or station.expected:
        return Rejection(
            "uncertain",
            f"It is not yet known what stands at {local(change.station)}.",
            "Answer the open question first (labos resolve); until then the workcell stays closed to runs.",
        )
    here = left.setdefault(change.station, list(station.labware))
    if change.what == "empty":
        gone = [name for name in here if name not in kept]
        events: list[Event] = [LabwareRemoved(n, "", GONE, f"taken away ({by})") for n in gone]
        here.clear()
        return [*events, StationDeclared(change.station, ())]
    if len(here) + len(station.stock) >= station.spec.capacity:
        return Rejection(
            "station_occupied",
            f"{local(change.station)} is full ({', '.join(here) or 'stock'}).",
            f"If it was cleared, report that too: --changed {local(change.station)}=empty",
        )
    labware = state.bench.labware.get(LabwareId(change.what))
    if labware is None:
        return _place_new(state, change, here, fresh)
    if labware.maybe or labware.moving:
        return Rejection(
            "uncertain",
            f"It is not yet known where {labware.id} is.",
            "Answer the open question: labos resolve",
        )
    before = left.setdefault(labware.station, list(state.bench.stations[labware.station].labware))
    if labware.id in before:  # otherwise the station was cleared
        before.remove(labware.id)
    here.append(labware.id)
    return [LabwareObserved(labware.id, "", change.station, by)]


def _place_new(
    state: LabState, change: ReportedChange, here: list[LabwareId], number: int
) -> list[Event] | Rejection:
    """The events of labware that is new to the log."""
    spec = state.bench.stations[change.station].spec
    if spec.kind in ("stack", "waste"):
        return Rejection(
            "stack",
            f"The pieces in {local(change.station)} are counted and have no ids.",
            f"Report how many there are: labos bench declare {local(change.station)}=NUMBERxTYPE",
        )
    if not spec.admits(change.what):
        return Rejection(
            "not_accepted",
            f"{local(change.station)} {spec.explain_refusal(change.what)}.",
            "Use the ids of known labware (labos labware)",
        )
    name = LabwareId(f"P{state.bench.named + number + 1}")
    here.append(name)
    return [LabwarePlaced(name, "", change.what, change.station, SHARED)]
