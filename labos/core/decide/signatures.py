"""Signing the record of a run, of an experiment or of a campaign."""

from __future__ import annotations

from labos.core.decide._base import Command, Decision, Rejection, decides
from labos.core.ids import RunId
from labos.core.signatures import Kind, Meaning, RecordsSigned, RunSigned
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.users import ON_BEHALF
from labos.core.words import Words


class SignRun(Command, frozen=True):
    """The user ``by`` has proven their identity with ``method``, and signs the ``records`` of a run, which
    have this digest."""

    run: RunId
    by: str
    meaning: Meaning
    records: int
    digest: str
    method: str
    why: Words = ""


class SignRecords(Command, frozen=True):
    """The same as ``SignRun`` for the ``records`` of an experiment or a campaign and of all its ``runs``."""

    subject: str
    kind: Kind
    by: str
    meaning: Meaning
    runs: int
    records: int
    digest: str
    method: str
    why: Words = ""


@decides(SignRun)
def sign_run(state: LabState, command: SignRun) -> Decision:
    if (refused := _check_signer(state, command.by)) is not None:
        return refused
    if state.runs.get(command.run) is not None:
        return _refuse_not_ended("run", command.run, "runs")
    return [make_from(RunSigned, command)]


@decides(SignRecords)
def sign_records(state: LabState, command: SignRecords) -> Decision:
    if (refused := _check_signer(state, command.by)) is not None:
        return refused
    if command.subject in (*state.experiments.open, *state.campaigns.open):
        where = "experiments" if command.kind == "experiment" else "campaign show"
        return _refuse_not_ended(command.kind, command.subject, where)
    return [make_from(RecordsSigned, command)]


def _check_signer(state: LabState, by: str) -> Rejection | None:
    if state.users.is_open:
        return Rejection(
            "no_users",
            "This lab has no users, so nobody can sign.",
            "Add the first, on the lab's computer: labos user add NAME",
        )
    user = state.users.known.get(by)
    if ON_BEHALF in by or user is None or user.kind == "service":
        return Rejection("no_person", f"{by} is not a person and cannot sign.", "Sign as a person.")
    return None


def _refuse_not_ended(kind: str, name: str, where: str) -> Rejection:
    return Rejection(
        "not_ended",
        f"The {kind} {name} has not ended: its record is not complete.",
        f"Wait for its end: labos {where} {name}",
    )
