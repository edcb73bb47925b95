"""Signing the record of a run."""

from __future__ import annotations

from labos.core.decide._base import Command, Decision, Rejection, decides
from labos.core.ids import RunId
from labos.core.signatures import Meaning, RunSigned
from labos.core.state import LabState
from labos.core.users import ON_BEHALF
from labos.core.words import Words


class SignRun(Command, frozen=True):
    """``by`` has shown who they are, by ``method``, and signs the ``records`` of a run, which have this
    digest."""

    run: RunId
    by: str
    meaning: Meaning
    records: int
    digest: str
    method: str
    why: Words = ""


@decides(SignRun)
def sign_run(state: LabState, command: SignRun) -> Decision:
    if state.users.is_open:
        return Rejection(
            "no_users",
            "This lab has no users, and does not know who signs.",
            "Add the first, on the lab's computer: labos user add NAME",
        )
    user = state.users.known.get(command.by)
    if ON_BEHALF in command.by or user is None or user.kind == "service":
        return Rejection("no_person", f"{command.by} is no person, and cannot sign.", "Sign yourself.")
    if state.runs.get(command.run) is not None:
        return Rejection(
            "not_ended",
            f"The run {command.run} has not ended: its record is not complete.",
            f"Wait for its end: labos runs {command.run}",
        )
    return [
        RunSigned(
            command.run,
            command.by,
            command.meaning,
            command.records,
            command.digest,
            command.method,
            command.why,
        )
    ]
