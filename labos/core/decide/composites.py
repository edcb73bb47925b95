"""Requests with several parts that belong together: one command, so that all parts are carried out, or none.

All parts are checked before anything happens, on the state before the first part. So no part may make another
one impossible.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain

from labos.core.decide._base import (
    Command,
    Decider,
    Decision,
    Rejection,
    check_recordable,
    decides,
    list_possible,
)
from labos.core.decide.interventions import ResolveIntervention, resolve_intervention
from labos.core.decide.lab import DeclareStation, declare_station
from labos.core.decide.runs import SubmitRun, submit_run
from labos.core.decide.shorter import (
    ConfirmStations,
    SayContents,
    confirm_stations,
    list_to_say,
    say_contents,
)
from labos.core.decide.stock import LoadStation, load_station
from labos.core.ids import StationName, local
from labos.core.labware import LabwarePlaced, StationLoaded
from labos.core.registry import Event
from labos.core.state import LabState
from labos.core.topics import ShorterLog


class SubmitWithLabware(Command, frozen=True):
    """Queue a run, and declare the labware that was put on the bench for it."""

    run: SubmitRun
    loads: tuple[LoadStation, ...] = ()

    def list_parts(self) -> Sequence[Command]:
        return (self.run, *self.loads)


class DeclareStations(Command, frozen=True):
    """Declare the contents of several stations."""

    stations: tuple[DeclareStation, ...]

    def list_parts(self) -> Sequence[Command]:
        return self.stations


class ReportRound(Command, frozen=True):
    """A person on the round reports the contents of ``stations``, and confirms the stations ``as_recorded``.
    Every possible report is recorded. With ``finish``, the question that asked for the round is answered as
    soon as no station is left to report."""

    by: str
    stations: tuple[SayContents, ...] = ()
    as_recorded: tuple[StationName, ...] = ()
    finish: bool = False

    def list_parts(self) -> Sequence[Command]:
        return (*self.stations, ConfirmStations(self.as_recorded, self.by))


@decides(SubmitWithLabware)
def submit_with_labware(state: LabState, command: SubmitWithLabware) -> Decision:
    if command.run.request and command.run.request in state.runs.requests:
        return []
    loads = load_stations(state, command.loads)
    if isinstance(loads, Rejection):
        return loads
    fit = check_recordable(submit_run(state, command.run))
    return fit if isinstance(fit, Rejection) else chain(loads, fit)


def load_stations(state: LabState, loads: Sequence[LoadStation]) -> Iterator[Event] | Rejection:
    """The events of labware that was put at several stations, or why it cannot stand there."""
    filled: set[StationName] = set()
    for load in loads:
        decision = load_station(state, load)
        if isinstance(decision, Rejection):
            return decision
        places = {e.station for e in decision if isinstance(e, LabwarePlaced | StationLoaded)}
        if places & filled:
            return Rejection(
                "twice",
                f"Labware was put at {local(min(places & filled))} twice.",
                "Put it there one after the other: labos load STATION --type TYPE",
            )
        filled |= places
    return carry_out_all(state, loads, load_station)


@decides(DeclareStations)
def declare_stations(state: LabState, command: DeclareStations) -> Decision:
    names = [declared.station for declared in command.stations]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        return Rejection("twice", f"{local(twice)} is declared twice.", "Declare it once.")
    for declared in command.stations:
        fit = check_recordable(declare_station(state, declared))
        if isinstance(fit, Rejection):
            return fit
    return carry_out_all(state, command.stations, declare_station)


def carry_out_all(state: LabState, parts: Iterable[Command], decider: Decider) -> Iterator[Event]:
    """The events of parts that were checked before and are possible."""
    for part in parts:
        decision = decider(state, part)
        if isinstance(decision, Rejection):
            raise RuntimeError(f"One part of the request makes another part impossible: {decision.message}")
        yield from decision


@decides(ReportRound)
def report_round(state: LabState, command: ReportRound) -> Decision:
    wrong = confirm_stations(state, ConfirmStations((), command.by))
    return wrong if isinstance(wrong, Rejection) else _report_round(state, command)


def _report_round(state: LabState, command: ReportRound) -> Iterator[Event]:
    for contents in command.stations:
        yield from list_possible(say_contents(state, contents))
    for name in command.as_recorded:
        yield from list_possible(confirm_stations(state, ConfirmStations((name,), command.by)))
    asked = state.interventions.open_about(ShorterLog)
    if command.finish and asked and not list_to_say(state):
        answer = ResolveIntervention(asked[0].id, "checked", command.by, "the whole bench was checked")
        yield from list_possible(resolve_intervention(state, answer))
