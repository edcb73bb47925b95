"""Labware gets another owner: a user, an experiment, or all users."""

from __future__ import annotations

from labos.core.bench import Labware
from labos.core.decide._base import Command, Decision, Rejection
from labos.core.decide.lookups import decides_about, expect_labware, find_owner
from labos.core.decide.users import refuse_unknown_user
from labos.core.ids import NOBODY, SHARED, ExperimentId, LabwareId, Owner, RunId, split_key
from labos.core.labware import LabwareHandedOver
from labos.core.open_experiments import ExperimentStatus
from labos.core.state import LabState
from labos.core.users import find_person
from labos.core.words import Words


class HandOver(Command, frozen=True):
    """Give labware to a user (``user:NAME``), an experiment (``experiment:E3``) or all users (``shared``).
    With ``force``, an operator gives away labware of other owners; ``note`` says why."""

    labware: LabwareId
    to: Owner
    by: str
    force: bool = False
    note: Words = ""


@decides_about(HandOver, expect_labware)
def hand_over(state: LabState, command: HandOver, labware: Labware) -> Decision:
    if labware.owner == command.to:
        return []
    wrong = (
        _refuse_heir(state, command.to)
        or _refuse_in_use(state, labware)
        or _refuse_not_theirs(state, labware, command)
    )
    if wrong:
        return wrong
    return [LabwareHandedOver(labware.id, "", command.to, command.by, command.note)]


def _refuse_heir(state: LabState, to: Owner) -> Rejection | None:
    kind, name = split_key(to)
    if kind == "user" and name and not state.users.is_open and state.users.get(name) is None:
        return refuse_unknown_user(name)
    if to == SHARED or (kind == "user" and name):
        return None
    if kind != "experiment":
        return Rejection(
            "no_owner",
            f"Labware cannot be given to {to!r}.",
            "Name a user (user NAME), an experiment (experiment E3) or `shared`.",
        )
    experiment = state.experiments.open.get(ExperimentId(name))
    if experiment is None or experiment.status != ExperimentStatus.OPEN:
        return Rejection("no_experiment", f"The experiment {name} is not open.", "See `labos experiments`.")
    return None


def _refuse_in_use(state: LabState, labware: Labware) -> Rejection | None:
    if labware.moving:
        return Rejection(
            "in_use", f"{labware.id} is being carried or worked on.", "Wait until that has ended."
        )
    kind, name = split_key(labware.owner)
    if kind == "run" and state.runs.get(name) is not None:
        return Rejection(
            "in_use",
            f"{labware.id} is in use by run {RunId(name)}.",
            "Wait until the run ends; then its experiment or user owns it.",
        )
    experiment = state.experiments.open.get(ExperimentId(name)) if kind == "experiment" else None
    if experiment is not None and experiment.status == ExperimentStatus.CLOSING:
        return Rejection(
            "in_use",
            f"The closing workflow of {experiment.id} is clearing {labware.id} away.",
            "Wait until the experiment has ended.",
        )
    return None


def _refuse_not_theirs(state: LabState, labware: Labware, command: HandOver) -> Rejection | None:
    owner = find_owner(state, labware.owner)
    if labware.owner in (NOBODY, SHARED) or owner == find_person(command.by):
        return None
    if not command.force:
        return Rejection(
            "not_yours",
            f"{labware.id} belongs to {labware.owner.replace(':', ' ')}, not to {command.by}.",
            "Ask them to hand it over; an operator can do it with --force and --why.",
        )
    if not command.note.strip():
        return Rejection(
            "no_note", f"Giving {labware.id} away without its owner needs a reason.", "Add --why."
        )
    return None
