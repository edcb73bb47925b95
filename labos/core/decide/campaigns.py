"""Campaigns: submitting, row by row; pausing, changing, stopping, cancelling; and their end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import Any

import msgspec

from labos.core.approvals import Demand
from labos.core.campaigns import (
    Campaign,
    CampaignAmended,
    CampaignArchived,
    CampaignCancelled,
    CampaignCompleted,
    CampaignPaused,
    CampaignResumed,
    CampaignRowRefused,
    CampaignStatus,
    CampaignStopped,
    CampaignSubmitted,
    CampaignUnarchived,
    EndedCampaign,
    Terms,
    explain_stop,
    is_over,
)
from labos.core.conditions import find_reads
from labos.core.decide._base import Command, Decision, InnerCommand, Rejection, decides, list_possible
from labos.core.decide.cancelling import cancel_all
from labos.core.decide.lookups import decides_about
from labos.core.decide.runs import NOBODYS, QUOTA, SubmitRun, submit_run
from labos.core.ids import CampaignId, RunId
from labos.core.model import MAIN, Plan
from labos.core.registry import Event
from labos.core.repeated import record_repeat
from labos.core.resources import sum_consumption
from labos.core.roles import explain_lacking_role
from labos.core.runs import RunPaused, RunResumed, RunSubmitted
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.texts import LONGEST_REASON, cut
from labos.core.users import UserDisabled
from labos.core.viewer import Visibility
from labos.core.words import Words

NO_ROOM = "no_room"
"""The code of a rejection of a row because too many runs of its campaign wait."""

NOT_NEXT = "not_next"
"""The code of a rejection of a row that is not the next one."""

NOT_OPEN = "not_open"
"""The code of a rejection of a row whose campaign takes no rows."""


class SubmitCampaign(Command, frozen=True):
    """Carry out a workflow for each row of a table. ``table`` and ``definition`` are digests of blobs; the
    same ``request`` twice is one campaign. ``demand`` is the work and material that its rows need by their
    plans. ``propose``: it waits for an approval, even if the policy does not demand one. ``visibility``: who
    can see it; ``cloned_from``: the campaign that it repeats; ``due``: the column with the due date of each
    row's run."""

    name: str
    user: str
    workflow: str
    workcell: str
    rows: int
    table: str
    definition: str
    terms: Terms = Terms()
    request: str = ""
    demand: Demand = Demand()
    propose: bool = False
    visibility: Visibility = "lab"
    cloned_from: CampaignId = CampaignId("")
    due: str = ""


class SubmitRow(InnerCommand, frozen=True):
    """The next row of a campaign becomes a run with the due date ``due_at`` (UTC ns)."""

    campaign: CampaignId
    row: int
    plan: Plan
    payload: dict[str, Any] = {}
    pins: dict[str, str] = {}
    others: tuple[Plan, ...] = ()
    due_at: int = 0


class RefuseRow(InnerCommand, frozen=True):
    """The next row of a campaign cannot become a run; ``why`` is the reason."""

    campaign: CampaignId
    row: int
    why: str


class SubmitRows(InnerCommand, frozen=True):
    """The next rows of a campaign become runs or are refused, one after the other, as long as there is
    room."""

    rows: tuple[SubmitRow | RefuseRow, ...]

    def list_parts(self) -> Sequence[Command]:
        return self.rows


class PauseCampaign(Command, frozen=True):
    campaign: CampaignId
    why: Words = ""


class ResumeCampaign(Command, frozen=True):
    campaign: CampaignId


class AmendCampaign(Command, frozen=True):
    """Continue a campaign under changed terms."""

    campaign: CampaignId
    terms: Terms


class CancelCampaign(Command, frozen=True):
    """Submit no further row and cancel the runs. ``stay``: their labware stays where it is."""

    campaign: CampaignId
    stay: bool = False
    why: Words = ""


class ArchiveCampaign(Command, frozen=True):
    """Hide a campaign that has ended from lists; ``undo``: show it again."""

    campaign: CampaignId
    undo: bool = False


def _expect_next(state: LabState, command: SubmitRow | RefuseRow) -> Campaign | Rejection:
    """The campaign, if this row is its next one and may be submitted now."""
    name, row = command.campaign, command.row
    campaign = state.campaigns.open.get(name)
    if campaign is None or campaign.status != CampaignStatus.OPEN or explain_stop(campaign):
        return Rejection(NOT_OPEN, f"The campaign {name} takes no rows.")
    if row != campaign.next_row or not campaign.left:
        return Rejection(NOT_NEXT, f"Row {row} of {name} is not the next one: {campaign.next_row} is.")
    if not campaign.room:
        return Rejection(NO_ROOM, f"{name} already has enough waiting runs.")
    return campaign


def _expect_alive(state: LabState, command: Any) -> Campaign | Rejection:
    found = state.campaigns.open.get(command.campaign)
    return found or Rejection("no_campaign", f"There is no campaign {command.campaign} that has not ended.")


@decides(SubmitCampaign)
def submit_campaign(state: LabState, command: SubmitCampaign) -> Decision:
    if command.request and command.request in state.campaigns.requests:
        return []
    if command.rows < 1:
        return Rejection("no_rows", f"The campaign {command.name!r} has no rows.", "Give a table with rows.")
    if command.workcell not in state.lab.workcells:
        return Rejection("no_workcell", f"This lab has no workcell {command.workcell!r}.")
    name = CampaignId(f"C{state.campaigns.named + 1}")
    return [make_from(CampaignSubmitted, command, campaign=name)]


@decides_about(SubmitRow, _expect_next)
def submit_row(state: LabState, command: SubmitRow, campaign: Campaign) -> Decision:
    needed = (explain_lacking_role(state, campaign.user, plan) for plan in (command.plan, *command.others))
    lacks = next(filter(None, needed), "")
    if lacks:
        return [CampaignStopped(campaign.id, cut(lacks, LONGEST_REASON))]
    beyond = explain_over_budget(state, campaign, command.plan)
    if beyond and campaign.runs:
        return Rejection(NO_ROOM, f"{campaign.id} continues if its runs use less than planned.")
    if beyond:
        return [CampaignStopped(campaign.id, beyond)]
    run = make_from(
        SubmitRun,
        command,
        user=campaign.user,
        priority=campaign.terms.priority,
        apart=campaign.id if campaign.id in state.campaigns.restricted else NOBODYS,
    )
    answer = submit_run(state, run)
    if isinstance(answer, Rejection) and answer.code == QUOTA:
        return Rejection(NO_ROOM, answer.message)
    if isinstance(answer, Rejection):
        why = f"{answer.message} {answer.remedy}".strip()
        return _record_refusal(campaign, command.row, why)
    reads = _find_steps_read(campaign, command.plan)
    member = {"campaign": campaign.id, "row": command.row, "reads": reads}
    return [
        msgspec.structs.replace(event, **member) if isinstance(event, RunSubmitted) else event
        for event in answer
    ]


@decides_about(RefuseRow, _expect_next)
def refuse_row(state: LabState, command: RefuseRow, campaign: Campaign) -> Decision:
    return _record_refusal(campaign, command.row, command.why)


@decides_about(PauseCampaign, _expect_alive)
def pause_campaign(state: LabState, command: PauseCampaign, campaign: Campaign) -> Decision:
    if campaign.status == CampaignStatus.PAUSED:
        return record_repeat(campaign.id, "pause", command.why)
    if campaign.status != CampaignStatus.OPEN:
        return _refuse_rows(campaign)
    waiting = [run for run in _find_queued(campaign) if not state.runs.queued[run].paused]
    return [
        CampaignPaused(campaign.id, command.why),
        *(RunPaused(run, f"{campaign.id} is paused") for run in waiting),
    ]


@decides_about(ResumeCampaign, _expect_alive)
def resume_campaign(state: LabState, command: ResumeCampaign, campaign: Campaign) -> Decision:
    if campaign.status == CampaignStatus.OPEN:
        return []
    if campaign.status != CampaignStatus.PAUSED:
        return _refuse_rows(campaign)
    waiting = [run for run in _find_queued(campaign) if state.runs.queued[run].paused]
    return [CampaignResumed(campaign.id), *map(RunResumed, waiting)]


@decides_about(AmendCampaign, _expect_alive)
def amend_campaign(state: LabState, command: AmendCampaign, campaign: Campaign) -> Decision:
    if campaign.is_ended:
        return _refuse_rows(campaign)
    unfit = check_terms(campaign, command.terms)
    if unfit is not None:
        return unfit
    return [] if command.terms == campaign.terms else [CampaignAmended(campaign.id, command.terms)]


def check_terms(campaign: Campaign, terms: Terms) -> Rejection | None:
    """Why a campaign cannot continue under these terms; None if it can."""
    until, known = terms.until, campaign.terms.until
    if (
        until is None
        or not campaign.next_row
        or (known is not None and find_reads(until) <= find_reads(known))
    ):
        return None
    return Rejection(
        "until_reads_more",
        f"The stop rule {until.text!r} needs results that the runs of {campaign.id} did not store.",
        "Name the steps that its stop rule named when it was submitted, or submit another campaign.",
    )


@decides_about(CancelCampaign, _expect_alive)
def cancel_campaign(state: LabState, command: CancelCampaign, campaign: Campaign) -> Decision:
    if campaign.status == CampaignStatus.CANCELLED:
        again = record_repeat(campaign.id, "cancel", command.why)
        runs = campaign.runs if command.stay else ()
        return chain(again, cancel_all(state, runs, command.why, stay=True))
    ended = CampaignCancelled(campaign.id, command.why)
    return chain([ended], cancel_all(state, campaign.runs, command.why, stay=command.stay))


@decides(ArchiveCampaign)
def archive_campaign(state: LabState, command: ArchiveCampaign) -> Decision:
    name = command.campaign
    if name in state.campaigns.open:
        return Rejection(
            "not_ended",
            f"The campaign {name} has not ended.",
            f"Wait for its end, or cancel it: labos campaign cancel {name}",
        )
    known: EndedCampaign | None = state.campaigns.ended.get(name)
    if known is None:
        return Rejection("no_campaign", f"There is no campaign {name}.", "List them: labos campaign list")
    if known.archived is not command.undo:
        return []
    return [CampaignUnarchived(name) if command.undo else CampaignArchived(name)]


def explain_over_budget(state: LabState, campaign: Campaign, plan: Plan) -> str:
    """Why a further run of a plan would exceed the campaign's budget, as a sentence; empty if it fits. Runs
    alive count in full, by their plans."""
    budget = campaign.terms.budget
    submitted = campaign.next_row - campaign.refused
    if budget.runs and submitted >= budget.runs:
        return f"Its budget of {budget.runs} runs is used up."
    plans = [
        plan,
        *(state.runs.plan_of(run) for run in map(state.runs.get, campaign.runs) if run is not None),
    ]
    if budget.lab_time_s:
        spent = campaign.spent_ns / 1e9 * state.lab.pace
        if spent + sum(map(compute_module_time_s, plans)) > budget.lab_time_s:
            return f"Another run would exceed its budget of {budget.lab_time_s / 3600:g} h lab time."
    for kind, most in budget.consumables.items():
        used = campaign.used.get(kind, 0.0)
        if used + sum(sum_consumption(plan).get(kind, 0.0) for plan in plans) > most:
            return f"Another run would exceed its budget of {most:g} {kind}."
    return ""


def compute_module_time_s(plan: Plan) -> float:
    """The nominal module time of a plan without failures, in lab seconds."""
    return sum(step.duration_s for step in plan.steps if step.part == MAIN)


def _find_steps_read(campaign: Campaign, plan: Plan) -> dict[str, int]:
    """The steps whose results the stop rule reads."""
    if campaign.terms.until is None:
        return {}
    wanted = find_reads(campaign.terms.until)
    return {step.key: index for index, step in enumerate(plan.steps) if step.key in wanted}


def _record_refusal(campaign: Campaign, row: int, why: str) -> list[Event]:
    return [CampaignRowRefused(campaign.id, row, cut(why, LONGEST_REASON))]


def _refuse_rows(campaign: Campaign) -> Rejection:
    if campaign.status == CampaignStatus.PROPOSED:
        return Rejection(
            NOT_OPEN,
            f"The campaign {campaign.id} waits for approval.",
            f"An operator approves it (labos approve {campaign.id}); or cancel it.",
        )
    return Rejection(
        NOT_OPEN,
        f"The campaign {campaign.id} was {campaign.status} and takes no more rows.",
        "Submit another campaign for the remaining rows.",
    )


def _find_queued(campaign: Campaign) -> list[RunId]:
    return [run for run, started in campaign.runs.items() if not started]


# -- reactions -----------------------------------------------------------------------------------


def conclude_campaigns(state: LabState, event: Event) -> Iterator[Event]:
    """A campaign that may not continue is stopped, and a campaign without remaining work is completed."""
    for name in list(state.campaigns.due):
        campaign = state.campaigns.open[name]
        if why := explain_stop(campaign):
            yield CampaignStopped(name, why, campaign.met_by)
            yield from cancel_all(state, _find_queued(campaign), f"{name} was stopped")
        elif is_over(campaign):
            yield make_from(CampaignCompleted, campaign, campaign=name)


def pause_campaigns(state: LabState, event: UserDisabled) -> Iterator[Event]:
    """The campaigns of a disabled user are paused until somebody resumes them."""
    for name in [known.id for known in state.campaigns.open.values() if known.user == event.user]:
        answer = pause_campaign(state, PauseCampaign(name, f"its user {event.user} was disabled"))
        yield from list_possible(answer)
