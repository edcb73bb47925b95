"""Permissions of users: one table with the permission that each command needs, and the check.

A lab without users is open. After the first user was added, every actor must be a user. Users may change
their own things; for things of others they need to be operators of the workcell. Commands that LabOS sends
itself (planning, nodes, the feeder of campaigns) are not checked."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import msgspec

from labos.core.decide import (
    access,
    actions,
    bookings,
    calibrations,
    campaigns,
    cancelling,
    choices,
    composites,
    control,
    erasure,
    experiments,
    handover,
    interventions,
    lab,
    labware,
    nodes,
    observation,
    proposals,
    runs,
    shares,
    shorter,
    signatures,
    steps,
    stock,
    submissions,
    suggestions,
    targets,
    teach,
    together,
    users,
    verification,
    work,
)
from labos.core.decide._base import DECIDERS, Command, InnerCommand, Rejection
from labos.core.decide.targets import ANYWHERE, Target
from labos.core.lab import WHOLE_LAB
from labos.core.roles import rank_role_in
from labos.core.state import LabState
from labos.core.users import LABOS, ON_BEHALF, ROLES, Role, rank

MOST_NAMED = 5
"""A refusal names at most this number of people who may do it."""


class Denied(Rejection, frozen=True):
    """The actor may not do this; ``remedy`` names the people who may."""


class Right(msgspec.Struct, frozen=True):
    """The permission that a command needs. ``role`` is the lowest role with which it may succeed; it is empty
    for commands that only LabOS sends. ``words`` describe the permission for the documentation. ``asker`` is
    the field with the user who asks."""

    role: Role | None
    words: str = ""
    touches: Callable[[LabState, Any], Iterable[Target]] = lambda state, command: ()
    asker: str = ""


def check_rights(state: LabState, command: Command, actor: str) -> Denied | None:
    """Why ``actor`` (a user's id, or ``on_behalf``) may not send a command; None if they may. The time is
    proportional to the number of the command's targets."""
    if _is_free(state, actor) or isinstance(command, nodes.RecordStops):
        return None
    right = RIGHTS[type(command)]
    service, _, person = actor.rpartition(ON_BEHALF)
    wrong = _refuse_names(state, person, service)
    if wrong:
        return wrong
    if right.role is None:
        return Denied("inside", f"{type(command).__name__} is a command that only LabOS itself uses.")
    asker = getattr(command, right.asker) if right.asker else person
    if asker != person and not (right.asker == "by" and asker == actor):
        return Denied(
            "not_you",
            f"{person} cannot send requests in the name of {asker}.",
            "Leave out `actor`. Only a service account can act on behalf of others.",
        )
    for target in right.touches(state, command):
        wrong = _refuse_target(state, target, person, service)
        if wrong:
            return wrong
    return next((wrong for part in command.list_parts() if (wrong := check_rights(state, part, actor))), None)


def check_role(state: LabState, actor: str, needs: Role, cell: str = ANYWHERE) -> Denied | None:
    """Why ``actor`` may not do something that is not a command but needs a role in a workcell (``*``: in the
    whole lab; empty: in any workcell). None if they may."""
    if _is_free(state, actor):
        return None
    service, _, person = actor.rpartition(ON_BEHALF)
    return _refuse_names(state, person, service) or _refuse_target(
        state, Target(needs, (cell,)), person, service
    )


def _is_free(state: LabState, actor: str) -> bool:
    """Whether no permission is needed: the lab is open, or LabOS itself acts."""
    return state.users.is_open or actor == LABOS or "/" in actor


def _refuse_names(state: LabState, person: str, service: str) -> Denied | None:
    """Why no user may act under these names; None if they may be used."""
    return _refuse_stranger(state, person) or (_refuse_agent(state, service, person) if service else None)


def _refuse_stranger(state: LabState, name: str) -> Denied | None:
    user = state.users.known.get(name)
    if user is None:
        return Denied(
            "unknown_user",
            f"{name!r} is no user of this lab.",
            f"An admin adds users (labos user add): {_list_names(state.users.list_admins())}.",
        )
    if user.disabled:
        return Denied(
            "disabled",
            f"The user {name} is disabled.",
            f"An admin can enable it: {_list_names(state.users.list_admins())}.",
        )
    return None


def _refuse_agent(state: LabState, service: str, person: str) -> Denied | None:
    wrong = _refuse_stranger(state, service)
    if wrong or state.users.known[service].kind == "service":
        return wrong
    return Denied(
        "no_service",
        f"{service} is a person and cannot act on behalf of {person}.",
        "Only a service account can: labos user add NAME --service",
    )


def _refuse_target(state: LabState, target: Target, person: str, service: str) -> Denied | None:
    own = target.owner in ("", person)
    if target.owner_only and not own:
        return Denied(
            "not_yours",
            f"{target.what} is {target.owner}'s, and {person} cannot use it.",
            f"Leave it out, or ask {target.owner}.",
        )
    needs = target.needs if own else max(target.needs, "operator", key=rank)
    askers = (person, service) if service else (person,)
    for cell in target.cells:
        weak = next((name for name in askers if rank_role_in(state, name, cell) < rank(needs)), None)
        if weak is not None:
            return _word_refusal(state, target, weak, needs, cell, own=own)
    return None


def _word_refusal(state: LabState, target: Target, who: str, needs: Role, cell: str, *, own: bool) -> Denied:
    where = {WHOLE_LAB: " of the whole lab", ANYWHERE: ""}.get(cell, f" in {cell}")
    may = _list_names(_find_who_may(state, needs, cell))
    if not own:
        return Denied(
            "not_yours",
            f"{target.what} is {target.owner}'s; {who} is no {needs}{where}.",
            f"Ask {target.owner}, or a user who has this right: {may}.",
        )
    has = ROLES[rank_role_in(state, who, cell)]
    grant = f"labos role grant {who} {needs}" + (
        f" --workcell {cell}" if cell not in (WHOLE_LAB, ANYWHERE) else ""
    )
    return Denied(
        "no_right",
        f"This needs the role {needs}{where}; {who} has the role {has} there.",
        f"Ask a user who has this right: {may}. An admin grants roles: {grant}",
    )


def _find_who_may(state: LabState, needs: Role, cell: str) -> list[str]:
    """The people who have at least a role; those with the lowest such role come first."""
    people = [name for name, user in state.users.known.items() if user.is_person]
    ranks = {name: rank_role_in(state, name, cell) for name in people}
    return sorted((name for name in people if ranks[name] >= rank(needs)), key=lambda name: ranks[name])


def _list_names(names: list[str]) -> str:
    more = ", …" if len(names) > MOST_NAMED else ""
    return f"{', '.join(names[:MOST_NAMED])}{more}" if names else "nobody yet"


# -- the table -----------------------------------------------------------------------------------

_INSIDE = Right(None, "LabOS itself")
_OWN = "its owner; else an operator"
_OPERATOR = "an operator"
_ADMIN = "an admin of the whole lab"
_SIGNING = Right("viewer", "a person, as themselves, with their password", targets.TO_SIGN, "by")

_INNER = (actions, choices, steps, together, verification, work)
"""These modules have only commands that LabOS itself sends."""

RIGHTS: dict[type[Command], Right] = {
    # runs, experiments and campaigns
    runs.SubmitRun: Right(
        "submitter",
        "a submitter; to reset a module, an operator; in an experiment, only its owner",
        targets.list_submission_targets,
        "user",
    ),
    composites.SubmitWithLabware: Right("submitter", "as for the run; for labware, an operator"),
    composites.SubmitRuns: Right("submitter", "as for each of the runs; for labware, an operator"),
    runs.PauseRun: Right("submitter", _OWN, targets.find_run_target),
    runs.ResumeRun: Right("submitter", _OWN, targets.find_run_target),
    cancelling.CancelRun: Right("submitter", _OWN, targets.find_run_target),
    experiments.StartExperiment: Right("submitter", "a submitter", targets.find_start_target, "user"),
    experiments.NoteExperiment: Right("submitter", _OWN, targets.find_experiment_target),
    experiments.ResumeExperiment: Right("submitter", _OWN, targets.find_experiment_target),
    experiments.EndExperiment: Right("submitter", _OWN, targets.find_experiment_target),
    control.CancelExperiment: Right("submitter", _OWN, targets.find_experiment_target, "by"),
    campaigns.SubmitCampaign: Right("submitter", "a submitter", targets.TO_SUBMIT, "user"),
    campaigns.PauseCampaign: Right("submitter", _OWN, targets.find_campaign_target),
    campaigns.ResumeCampaign: Right("submitter", _OWN, targets.find_campaign_target),
    campaigns.AmendCampaign: Right("submitter", _OWN, targets.find_campaign_target),
    campaigns.CancelCampaign: Right("submitter", _OWN, targets.find_campaign_target),
    campaigns.ArchiveCampaign: Right("submitter", _OWN, targets.find_campaign_target),
    control.PauseStarts: Right("submitter", "an experiment: " + _OWN, targets.find_named_target, "by"),
    control.ResumeStarts: Right("submitter", "an experiment: " + _OWN, targets.find_named_target, "by"),
    control.CancelRuns: Right("operator", _OPERATOR, targets.find_named_target),
    signatures.SignRun: _SIGNING,
    signatures.SignRecords: _SIGNING,
    proposals.ApproveProposal: Right(
        "operator",
        "an operator; for own submissions, only if the policy allows it",
        targets.find_proposal_target,
        "by",
    ),
    proposals.RefuseProposal: Right("operator", _OPERATOR, targets.find_proposal_target, "by"),
    # labware
    handover.HandOver: Right(
        "submitter", "its owner; with `force`, an operator", targets.list_handover_targets, "by"
    ),
    labware.RegisterSamples: Right("submitter", "its owner; else an operator", targets.list_plate_targets),
    labware.NameBarcode: Right("submitter", _OWN, targets.find_label_target, "by"),
    # the bench
    lab.DeclareStation: Right("operator", _OPERATOR, targets.AT_STATION),
    composites.DeclareStations: Right("operator", _OPERATOR),
    stock.LoadStation: Right("operator", _OPERATOR, targets.AT_STATION),
    stock.UnloadStation: Right("operator", _OPERATOR, targets.AT_STATION, "by"),
    stock.Replenish: Right("operator", _OPERATOR, targets.AT_MODULE),
    observation.ObserveStation: Right("operator", _OPERATOR, targets.AT_STATION, "by"),
    shorter.SayContents: Right("operator", _OPERATOR, targets.AT_STATION, "by"),
    shorter.ConfirmStations: Right("operator", _OPERATOR, targets.list_station_targets, "by"),
    composites.ReportRound: Right(
        "operator", "an operator; to finish it, of the whole lab", targets.ON_ROUND, "by"
    ),
    interventions.ResolveIntervention: Right(
        "submitter",
        "an operator; for questions about a run or an experiment also its owner",
        targets.list_question_targets,
        "by",
    ),
    # modules and workcells
    nodes.TakeOut: Right("operator", _OPERATOR, targets.AT_MODULE),
    nodes.PutBack: Right("operator", _OPERATOR, targets.AT_MODULE),
    teach.TeachLocation: Right("operator", _OPERATOR, targets.AT_MODULE, "by"),
    calibrations.CalibrateModule: Right("operator", _OPERATOR, targets.AT_MODULE, "by"),
    access.RequestAccess: Right("operator", _OPERATOR, targets.IN_WORKCELL, "by"),
    access.EndAccess: Right("operator", _OPERATOR, targets.IN_WORKCELL, "by"),
    lab.ApplyWorkcell: Right(
        "admin", "an admin of the workcell; for a new one, of the whole lab", targets.find_file_target
    ),
    suggestions.SuggestOrder: Right("operator", _OPERATOR, targets.IN_WORKCELL, "by"),
    # bookings
    bookings.MakeBooking: Right(
        "submitter",
        "for oneself or the own group, within a quota: a submitter; else an operator; by force: an admin",
        targets.find_new_booking_target,
        "by",
    ),
    bookings.ChangeBooking: Right(
        "submitter",
        "its owner, within the same limits; else an operator; by force: an admin",
        targets.list_changed_booking_targets,
        "by",
    ),
    bookings.CancelBooking: Right("submitter", _OWN, targets.find_booking_target, "by"),
    # people
    shares.ApplyShares: Right("admin", _ADMIN, targets.IN_LAB),
    submissions.ApplyPolicy: Right("admin", _ADMIN, targets.IN_LAB),
    erasure.EraseWords: Right("admin", _ADMIN, targets.IN_LAB, "by"),
    erasure.RefuseErasure: Right("admin", _ADMIN, targets.IN_LAB, "by"),
    users.AddUser: Right("admin", _ADMIN, targets.IN_LAB),
    users.DisableUser: Right("admin", _ADMIN, targets.IN_LAB),
    users.EnableUser: Right("admin", _ADMIN, targets.IN_LAB),
    users.EraseUser: Right("viewer", "the user, or " + _ADMIN, targets.find_erasure_target, "by"),
    users.AddGroup: Right("admin", _ADMIN, targets.IN_LAB),
    users.RemoveGroup: Right("admin", _ADMIN, targets.IN_LAB),
    users.AddMember: Right("admin", _ADMIN, targets.IN_LAB),
    users.RemoveMember: Right("admin", _ADMIN, targets.IN_LAB),
    users.GrantRole: Right("admin", "an admin of where the role is granted", targets.TO_GRANT),
    users.RevokeRole: Right("admin", "an admin of where the role is revoked", targets.TO_GRANT),
    nodes.RecordStops: Right("viewer", "the person who stopped it; it is recorded in any case"),
    **{
        command: _INSIDE
        for command in DECIDERS
        if issubclass(command, InnerCommand) and command is not nodes.RecordStops
    },
}
"""The right that each command needs."""
