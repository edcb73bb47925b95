"""Requests with several parts that belong together: one command, so that all parts are carried out, or none.

All parts are checked before anything happens, on the state before the first part. So no part may make another
one impossible.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain

import msgspec

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
from labos.core.decide.runs import QUOTA, QUOTA_REMEDY, SubmitRun, submit_run
from labos.core.decide.shorter import (
    ConfirmStations,
    SayContents,
    confirm_stations,
    list_to_say,
    say_contents,
)
from labos.core.decide.stock import LoadStation, load_station
from labos.core.ids import ExperimentId, StationName, local
from labos.core.labware import LabwarePlaced, StationLoaded
from labos.core.quotas import explain_full_queue
from labos.core.registry import Event
from labos.core.state import LabState
from labos.core.topics import ShorterLog

MOST_RUNS = 50
"""The most runs of one command: all are decided in one turn of the kernel."""


class SubmitWithLabware(Command, frozen=True):
    """Queue a run, and declare the labware that was put on the bench for it."""

    run: SubmitRun
    loads: tuple[LoadStation, ...] = ()

    def list_parts(self) -> Sequence[Command]:
        return (self.run, *self.loads)


class SubmitRuns(Command, frozen=True):
    """Queue several runs, in order, and declare the labware that was put on the bench for them. A rejection
    names the run by the number of its payload; ``first`` is the number of payloads that were sent before."""

    runs: tuple[SubmitRun, ...]
    loads: tuple[LoadStation, ...] = ()
    first: int = 0

    def list_parts(self) -> Sequence[Command]:
        return (*self.runs, *self.loads)


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


@decides(SubmitRuns)
def submit_runs(state: LabState, command: SubmitRuns) -> Decision:
    new = list_new(state, command)
    if not new:
        return []
    if len(command.runs) > MOST_RUNS:
        return Rejection(
            "too_many", f"{len(command.runs)} runs in one request are too many; {MOST_RUNS} are allowed."
        )
    loads = load_stations(state, command.loads)
    if isinstance(loads, Rejection):
        return loads
    keys: dict[str, int] = {}
    ahead: dict[str, int] = {}
    for number, run in new.items():
        if run.request and keys.setdefault(run.request, number) != number:
            other = name_payload(command, keys[run.request])
            why = f"Its key {run.request!r} is also the key of {other}."
            return name_run(command, number, Rejection("twice", why, "Give each run its own key."))
        fit = check_recordable(submit_run(state, run))
        if isinstance(fit, Rejection):
            return name_run(command, number, fit)
        user = _find_user(state, run)
        full = explain_full_queue(state, user, ahead.get(user, 0))
        if full:
            return name_run(command, number, Rejection(QUOTA, full, QUOTA_REMEDY))
        ahead[user] = ahead.get(user, 0) + 1
    return chain(loads, carry_out_all(state, new.values(), submit_run))


def list_new(state: LabState, command: SubmitRuns) -> dict[int, SubmitRun]:
    """The runs that are new to the log, by their numbers in the command."""
    known = state.runs.requests
    return {
        number: run for number, run in enumerate(command.runs) if not run.request or run.request not in known
    }


def name_payload(command: SubmitRuns, number: int) -> str:
    return f"payloads[{command.first + number}]"


def name_run(command: SubmitRuns, number: int, why: Rejection) -> Rejection:
    """The rejection of one run, as the rejection of the whole command."""
    message = f"{name_payload(command, number)}: {why.message} None of the runs was submitted."
    return msgspec.structs.replace(why, message=message)


def _find_user(state: LabState, run: SubmitRun) -> str:
    experiment = state.experiments.open.get(ExperimentId(run.experiment))
    return experiment.user if experiment is not None else run.user


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
