"""The targets of a command: where they are, and who owns them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import msgspec

from labos.core.bench import Labware
from labos.core.decide import (
    bookings,
    experiments,
    handover,
    interventions,
    lab,
    labware,
    proposals,
    runs,
    shorter,
    users,
)
from labos.core.decide.lookups import find_owner
from labos.core.ids import (
    CampaignId,
    ExperimentId,
    LabwareId,
    ModuleName,
    RunId,
    StationName,
    experiment_owner,
    split_key,
    workcell_of,
)
from labos.core.lab import WHOLE_LAB
from labos.core.roles import find_role_for
from labos.core.state import LabState
from labos.core.topics import Approval, ClosingWaits, FailedStep, LateStep, LostExperiment
from labos.core.users import Role, find_person

ANYWHERE = ""
"""Stands for the workcell if a role in any workcell is enough."""

OWN_QUESTIONS = (FailedStep, LateStep, ClosingWaits, LostExperiment)
"""Questions about the continuation of a run or an experiment, which its owner may answer. All other questions
are about observations."""


class Target(msgspec.Struct, frozen=True):
    """A thing that a command changes: its workcell, its owner (empty: none), and its name. ``needs`` is the
    required role. With ``owner_only``, no role replaces being its owner."""

    needs: Role
    cells: tuple[str, ...]
    owner: str = ""
    what: str = ""
    owner_only: bool = False


def require(needs: Role, find_cell: Callable[[Any], str]) -> Callable[[LabState, Any], Iterable[Target]]:
    """The targets of commands that need a role in one place, which the command itself names."""
    return lambda state, command: (Target(needs, (find_cell(command),)),)


IN_LAB = require("admin", lambda command: WHOLE_LAB)
TO_SIGN = require("viewer", lambda command: ANYWHERE)
TO_GRANT = require("admin", lambda command: command.scope)
AT_MODULE = require("operator", lambda command: workcell_of(command.module))
AT_STATION = require("operator", lambda command: workcell_of(command.station))
IN_WORKCELL = require("operator", lambda command: command.workcell)
TO_SUBMIT = require("submitter", lambda command: command.workcell)
ON_ROUND = require("operator", lambda command: WHOLE_LAB if command.finish else ANYWHERE)
"""The stations of a round are checked one by one."""


def list_station_targets(state: LabState, command: shorter.ConfirmStations) -> Iterable[Target]:
    return [Target("operator", (workcell_of(name),)) for name in command.stations]


def target_run(state: LabState, name: str) -> Target:
    run = state.runs.get(name)
    if run is None:  # it will be refused for that reason
        return Target("submitter", (ANYWHERE,))
    return Target("submitter", (state.runs.plan_of(run).workcell,), run.user, f"The run {run.id}")


def find_run_target(state: LabState, command: Any) -> Iterable[Target]:
    return (target_run(state, command.run),)


def target_experiment(state: LabState, name: str, *, owner_only: bool = False) -> Target:
    experiment = state.experiments.open.get(ExperimentId(name))
    if experiment is None:
        return Target("submitter", (ANYWHERE,))
    found = [state.runs.get(run) for run in experiment.runs]
    cells = [state.runs.plan_of(run).workcell for run in found if run is not None]
    cells += [state.runs.plans[experiment.closing].plan.workcell] if experiment.closing else []
    owned = state.bench.list_owned(experiment_owner(experiment.id))
    places = [*experiment.parking, *(item.station for item in owned if item.station)]
    cells += map(workcell_of, places)
    there = tuple(dict.fromkeys(cells)) or (ANYWHERE,)
    return Target("submitter", there, experiment.user, f"The experiment {experiment.id}", owner_only)


def find_experiment_target(state: LabState, command: Any) -> Iterable[Target]:
    return (target_experiment(state, command.experiment),)


def find_campaign_target(state: LabState, command: Any) -> Iterable[Target]:
    name = CampaignId(command.campaign)
    campaign = state.campaigns.open.get(name) or state.campaigns.ended.get(name)
    if campaign is None:
        return (Target("submitter", (ANYWHERE,)),)
    return (Target("submitter", (campaign.workcell,), campaign.user, f"The campaign {name}"),)


def target_labware(state: LabState, name: LabwareId) -> Target:
    item = state.bench.labware.get(name)
    if item is None:
        return Target("submitter", (ANYWHERE,))
    return Target("submitter", (cell_of(item),), find_owner(state, item.owner), str(item.id))


def cell_of(item: Labware) -> str:
    place = item.station or next(filter(None, item.maybe), "")
    return workcell_of(StationName(place)) if place else ANYWHERE


def find_label_target(state: LabState, command: labware.NameBarcode) -> Iterable[Target]:
    """Everybody may use shared labware, but not everybody may rename it."""
    target = target_labware(state, command.labware)
    yield target if target.owner else msgspec.structs.replace(target, needs="operator")


def list_plate_targets(state: LabState, command: labware.RegisterSamples) -> Iterable[Target]:
    return [target_labware(state, plate.labware) for plate in command.plates]


def list_handover_targets(state: LabState, command: handover.HandOver) -> Iterable[Target]:
    target = target_labware(state, command.labware)
    kind, name = split_key(command.to)
    if kind == "experiment":
        yield target_experiment(state, name)
    yield msgspec.structs.replace(target, needs="operator") if command.force else target


def list_submission_targets(state: LabState, command: runs.SubmitRun) -> Iterable[Target]:
    if command.experiment:
        yield target_experiment(state, command.experiment, owner_only=True)
    for plan in command.plans:
        yield Target(find_role_for(plan), (plan.workcell,))


def find_start_target(state: LabState, command: experiments.StartExperiment) -> Iterable[Target]:
    plan = command.closing
    yield Target(find_role_for(plan), (plan.workcell,)) if plan else Target("submitter", (ANYWHERE,))


def find_file_target(state: LabState, command: lab.ApplyWorkcell) -> Iterable[Target]:
    name = command.workcell.name
    yield Target("admin", (name if name in state.lab.workcells else WHOLE_LAB,))


def find_named_target(state: LabState, command: Any) -> Iterable[Target]:
    """A module, a workcell, the whole lab, or an experiment."""
    if ExperimentId(command.target) in state.experiments.open:
        yield target_experiment(state, command.target)
    else:
        known = ModuleName(command.target) in state.modules.by_name
        yield Target("operator", (workcell_of(ModuleName(command.target)) if known else command.target,))


def list_question_targets(state: LabState, command: interventions.ResolveIntervention) -> Iterable[Target]:
    question = state.interventions.open.get(command.intervention)
    if question is None:
        yield Target("submitter", (ANYWHERE,))
        return
    if question.kind == "lost_experiment":
        target = target_experiment(state, question.subject)
    elif isinstance(question.topic, Approval):
        target = Target("operator", cells_of(state, question.topic.about))
    elif question.run and state.runs.get(question.run) is not None:
        target = target_run(state, RunId(question.run))
    elif question.module:
        target = Target("operator", (workcell_of(ModuleName(question.module)),))
    else:
        items = [state.bench.labware[name] for name in question.labware if name in state.bench.labware]
        target = Target("operator", tuple(dict.fromkeys(map(cell_of, items))) or (WHOLE_LAB,))
    if isinstance(question.topic, OWN_QUESTIONS):
        yield target
    else:
        yield Target("operator", target.cells)


def find_proposal_target(
    state: LabState, command: proposals.ApproveProposal | proposals.RefuseProposal
) -> Iterable[Target]:
    yield Target("operator", cells_of(state, command.subject))


def cells_of(state: LabState, subject: str) -> tuple[str, ...]:
    """The workcells of a run, a campaign or an experiment."""
    campaign = state.campaigns.open.get(CampaignId(subject))
    if campaign is not None:
        return (campaign.workcell,)
    if ExperimentId(subject) in state.experiments.open:
        return target_experiment(state, subject).cells
    return target_run(state, subject).cells


def find_new_booking_target(state: LabState, command: bookings.MakeBooking) -> Iterable[Target]:
    yield Target(_find_role_to_book(state, command), (workcell_of(ModuleName(command.target)),))


def list_changed_booking_targets(state: LabState, command: bookings.ChangeBooking) -> Iterable[Target]:
    for target in find_booking_target(state, command):
        yield target
        yield Target(_find_role_to_book(state, command), target.cells)


def _find_role_to_book(state: LabState, command: bookings.MakeBooking | bookings.ChangeBooking) -> Role:
    """Bookings for others, for maintenance, and repeated bookings need an operator. Overriding bookings of
    others needs an admin."""
    terms, who = command.terms, find_person(command.by)
    group = state.shares.group_of.get(who, "")
    own = (terms.user == who) if terms.user else bool(terms.group) and terms.group == group
    if command.force:
        return "admin"
    return "submitter" if own and not terms.rule and not terms.maintenance else "operator"


def find_booking_target(state: LabState, command: Any) -> Iterable[Target]:
    booking = state.bookings.open.get(command.booking)
    if booking is None:
        return (Target("submitter", (ANYWHERE,)),)
    owner = booking.user or find_person(booking.by)
    return (Target("submitter", (booking.cell,), owner, f"The booking {booking.id}"),)


def find_erasure_target(state: LabState, command: users.EraseUser) -> Iterable[Target]:
    own = command.by == command.user
    return (Target("viewer", (ANYWHERE,)) if own else Target("admin", (WHOLE_LAB,)),)
