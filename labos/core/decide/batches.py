"""Runs that are submitted together: one command queues all of them before the first one starts, or none."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import msgspec

from labos.core.decide._base import Command, Decision, Rejection, check_recordable, decides
from labos.core.decide.composites import carry_out_all, load_stations
from labos.core.decide.runs import QUOTA, QUOTA_REMEDY, SubmitRun, submit_run
from labos.core.decide.stock import LoadStation
from labos.core.ids import ExperimentId
from labos.core.quotas import explain_full_queue
from labos.core.state import LabState

MOST_RUNS = 50
"""The most runs of one command: all are decided in one turn of the kernel."""


class SubmitRuns(Command, frozen=True):
    """Queue several runs, in order, and declare the labware that was put on the bench for them. A rejection
    names the run by the number of its payload; ``first`` is the number of payloads that were sent before."""

    runs: tuple[SubmitRun, ...]
    loads: tuple[LoadStation, ...] = ()
    first: int = 0

    def list_parts(self) -> Sequence[Command]:
        return (*self.runs, *self.loads)


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
