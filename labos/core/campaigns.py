"""Campaigns: one workflow, carried out once for each row of a table.

The table itself is a blob. A campaign stores the number of its rows and the index of the next one. Rows
become runs in order, so each row becomes exactly one run. A campaign of many rows takes no more memory than
one of few.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Any

import msgspec

from labos.core.actions import ActionEnd, ActionReconciled, ActionRequested, ActionSucceeded
from labos.core.conditions import holds
from labos.core.expressions import ExpressionError
from labos.core.ids import ActionId, CampaignId, RunId
from labos.core.model import Condition
from labos.core.registry import Event, event
from labos.core.resources import ResourceConsumed
from labos.core.runs import (
    REQUESTS_KEPT,
    RunCancelled,
    RunCompleted,
    RunEnd,
    RunFailed,
    RunStarted,
    RunSubmitted,
)
from labos.core.steps import StepUnexpected
from labos.core.structs import make_from
from labos.core.viewer import RestrictedCampaign, Visibility
from labos.core.words import Words

ROWS_QUEUED = 4
"""At most this number of runs of a campaign wait for their start; the other rows wait in its table."""


class Budget(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The most that a campaign may use: runs, module time in lab seconds (0: no limit), and consumables by
    kind, each in its own unit."""

    runs: int = 0
    lab_time_s: float = 0.0
    consumables: dict[str, float] = {}


class Terms(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The part of a campaign that can be changed while it is running. ``deadline`` is in UTC ns (0: none). As
    soon as ``until`` is true for the results of a completed run, or ``stop_after`` runs have failed (0: no
    limit), no further row is submitted."""

    priority: int = 0
    deadline: int = 0
    budget: Budget = Budget()
    tags: tuple[str, ...] = ()
    until: Condition | None = None
    stop_after: int = 0


ARCHIVE = "archive"
"""The stream for archived campaigns: the stream of a campaign ends with the campaign."""


class CampaignEvent(Event, frozen=True):
    STREAM = "campaign"
    campaign: CampaignId


@event("campaign.submitted")
class CampaignSubmitted(CampaignEvent, frozen=True):
    """A workflow is to be carried out once for each row. ``rows`` is their number. ``table`` is the digest of
    the rows (one JSON object per line); ``definition`` is the digest of the workflow's text and files.
    ``cloned_from`` is the campaign from which rows and workflow were copied. ``due`` is the column with the
    due date of each row's run."""

    name: str
    user: str
    workflow: str
    workcell: str
    rows: int
    table: str
    definition: str
    terms: Terms = Terms()
    request: str = ""
    visibility: Visibility = "lab"
    cloned_from: CampaignId = CampaignId("")
    due: str = ""


@event("campaign.paused")
class CampaignPaused(CampaignEvent, frozen=True):
    """No further row is submitted. Waiting runs are paused; runs that have started continue."""

    why: Words = ""


@event("campaign.resumed")
class CampaignResumed(CampaignEvent, frozen=True):
    """Rows are submitted again."""


@event("campaign.amended")
class CampaignAmended(CampaignEvent, frozen=True):
    """The campaign continues with these terms. Runs that were submitted before keep their priority."""

    terms: Terms


@event("campaign.row_refused")
class CampaignRowRefused(CampaignEvent, frozen=True):
    """A row cannot be carried out in the present lab, so no run is submitted for it."""

    row: int
    why: str


@event("campaign.stopped")
class CampaignStopped(CampaignEvent, frozen=True):
    """The campaign's own rules end it: no further row is submitted, and runs that have started continue.
    ``by_run`` is the run whose results fulfilled the stop rule."""

    why: str
    by_run: str = ""


@event("campaign.cancelled")
class CampaignCancelled(CampaignEvent, frozen=True):
    """A user cancelled the campaign: no further row is submitted, and its runs are cancelled."""

    why: Words = ""


@event("campaign.completed")
class CampaignCompleted(CampaignEvent, frozen=True):
    """All work of the campaign has ended. The counts are numbers of rows; ``left`` is the number of rows for
    which no run was submitted."""

    completed: int
    failed: int
    cancelled: int
    refused: int
    left: int
    why: str = ""


class ArchiveEvent(Event, frozen=True):
    campaign: CampaignId

    def stream(self) -> str:
        return ARCHIVE


@event("campaign.archived")
class CampaignArchived(ArchiveEvent, frozen=True):
    """A campaign that has ended is hidden from lists."""


@event("campaign.unarchived")
class CampaignUnarchived(ArchiveEvent, frozen=True):
    """An archived campaign is shown in lists again."""


class CampaignStatus(StrEnum):
    """``OPEN``: its rows become runs. ``PROPOSED``: it waits for an approval. ``STOPPED``: its own rules
    ended it, and its runs continue. ``CANCELLED``: its runs are cancelled too."""

    OPEN = "open"
    PAUSED = "paused"
    STOPPED = "stopped"
    CANCELLED = "cancelled"
    PROPOSED = "proposed"


class Campaign(msgspec.Struct):
    """``next_row`` is the first row that is not submitted yet. ``runs`` are the runs alive, with whether each
    has started. ``spent_ns`` is module time in wall nanoseconds; ``used`` are consumables by kind. ``reads``
    and ``results`` of runs alive are for the stop rule; ``met_by`` is the run that fulfilled it.
    ``first_started_at`` is in UTC ns. ``danger_seen``: it was known at its approval that its rows have
    dangerous steps. ``due`` is the column with the due date of each row's run, if there is one."""

    id: CampaignId
    name: str
    user: str
    workflow: str
    workcell: str
    rows: int
    table: str
    definition: str
    submitted_at: int
    terms: Terms = Terms()
    status: CampaignStatus = CampaignStatus.OPEN
    why: str = ""
    next_row: int = 0
    runs: dict[RunId, bool] = {}
    completed: int = 0
    failed: int = 0
    cancelled: int = 0
    refused: int = 0
    spent_ns: int = 0
    used: dict[str, float] = {}
    reads: dict[RunId, dict[str, int]] = {}
    results: dict[RunId, dict[str, Any]] = {}
    met_by: str = ""
    first_started_at: int = 0
    danger_seen: bool = False
    due: str = ""
    cloned_from: CampaignId = CampaignId("")

    @property
    def queued(self) -> int:
        """The number of its runs that wait for their start."""
        return sum(not started for started in self.runs.values())

    @property
    def left(self) -> int:
        """The number of rows that are not submitted yet."""
        return self.rows - self.next_row

    @property
    def is_ended(self) -> bool:
        """Whether no further row will be submitted, by its own rules or because a person ended it."""
        return self.status in (CampaignStatus.STOPPED, CampaignStatus.CANCELLED)

    @property
    def room(self) -> int:
        """The number of further rows that may be submitted now."""
        if self.status != CampaignStatus.OPEN or explain_stop(self):
            return 0
        return max(min(self.left, ROWS_QUEUED - self.queued), 0)


class EndedCampaign(msgspec.Struct):
    """The data that remain of a campaign that has ended."""

    user: str
    workcell: str
    archived: bool = False


class Campaigns(msgspec.Struct):
    """``open`` are the campaigns that are not completed; ``named`` and ``requests`` are as for runs.
    ``members`` are the campaigns' runs alive. ``clocks`` hold the times at which their open actions were
    requested. ``parts`` counts the actions that share the time of their module, because the device carries
    them out at once. ``due`` are the campaigns that must be stopped or are over. ``ended`` and ``restricted``
    are never deleted: a campaign may be archived years later, and its events stay in the log."""

    open: dict[CampaignId, Campaign] = {}
    named: int = 0
    requests: dict[str, CampaignId] = {}
    members: dict[RunId, CampaignId] = {}
    clocks: dict[ActionId, int] = {}
    parts: dict[ActionId, int] = {}
    due: dict[CampaignId, bool] = {}
    ended: dict[CampaignId, EndedCampaign] = {}
    restricted: dict[CampaignId, RestrictedCampaign] = {}

    def visibility_of(self, campaign: CampaignId) -> Visibility:
        known = self.restricted.get(campaign)
        return known.visibility if known is not None else "lab"

    def find_by_run(self, run: str) -> Campaign | None:
        """The campaign of a run that is alive."""
        member = self.members.get(RunId(run))
        return self.open[member] if member is not None else None


def explain_stop(campaign: Campaign) -> str:
    """Why the campaign's own rules allow no further run, as a sentence; empty if they allow it."""
    terms = campaign.terms
    failed = campaign.failed + campaign.refused
    if campaign.is_ended or not (campaign.left or campaign.queued):
        return ""
    if campaign.met_by and terms.until is not None:
        return f"Its stop rule holds for {campaign.met_by}: {terms.until.text}."
    if terms.stop_after and failed >= terms.stop_after:
        return f"{failed} of its rows failed; at most {terms.stop_after} may fail."
    return ""


def is_over(campaign: Campaign) -> bool:
    """Whether a campaign has no work left."""
    return not campaign.runs and (campaign.is_ended or not campaign.left)


def fold_campaign_submitted(campaigns: Campaigns, event: CampaignSubmitted, at: int) -> None:
    campaigns.named += 1
    if event.request:
        campaigns.requests[event.request] = event.campaign
        while len(campaigns.requests) > REQUESTS_KEPT:
            del campaigns.requests[next(iter(campaigns.requests))]
    campaigns.open[event.campaign] = make_from(Campaign, event, id=event.campaign, submitted_at=at)
    if event.visibility != "lab":
        campaigns.restricted[event.campaign] = RestrictedCampaign(
            event.user, event.workcell, event.visibility
        )


_STATUS: dict[type[Event], CampaignStatus] = {
    CampaignPaused: CampaignStatus.PAUSED,
    CampaignResumed: CampaignStatus.OPEN,
    CampaignStopped: CampaignStatus.STOPPED,
    CampaignCancelled: CampaignStatus.CANCELLED,
}


def fold_campaign_status(
    campaigns: Campaigns,
    event: CampaignPaused | CampaignResumed | CampaignStopped | CampaignCancelled,
    at: int,
) -> None:
    campaign = campaigns.open[event.campaign]
    campaign.status = _STATUS[type(event)]
    campaign.why = "" if isinstance(event, CampaignResumed) else event.why
    note_due(campaigns, campaign)


def fold_campaign_amended(campaigns: Campaigns, event: CampaignAmended, at: int) -> None:
    campaign = campaigns.open[event.campaign]
    campaign.terms = event.terms
    note_due(campaigns, campaign)


def fold_campaign_row_refused(campaigns: Campaigns, event: CampaignRowRefused, at: int) -> None:
    campaign = campaigns.open[event.campaign]
    campaign.next_row = event.row + 1
    campaign.refused += 1
    note_due(campaigns, campaign)


def fold_campaign_completed(campaigns: Campaigns, event: CampaignCompleted, at: int) -> None:
    campaign = campaigns.open.pop(event.campaign)
    campaigns.due.pop(event.campaign, None)
    campaigns.ended[event.campaign] = EndedCampaign(campaign.user, campaign.workcell)


def fold_archive(campaigns: Campaigns, event: CampaignArchived | CampaignUnarchived, at: int) -> None:
    campaigns.ended[event.campaign].archived = isinstance(event, CampaignArchived)


def fold_run_submitted(campaigns: Campaigns, event: RunSubmitted, at: int) -> None:
    campaign = campaigns.open.get(event.campaign)
    if campaign is None:
        return
    if event.row != campaign.next_row:
        raise ValueError(
            f"row {event.row} of {campaign.id} was submitted, but the next row is {campaign.next_row}"
        )
    campaign.next_row += 1
    campaign.runs[event.run] = False
    campaigns.members[event.run] = campaign.id
    if event.reads:
        campaign.reads[event.run] = event.reads


def fold_run_started(campaigns: Campaigns, event: RunStarted, at: int) -> None:
    campaign = campaigns.find_by_run(event.run)
    if campaign is not None:
        campaign.runs[event.run] = True
        campaign.first_started_at = campaign.first_started_at or at


def fold_run_ended(campaigns: Campaigns, event: RunEnd, at: int) -> None:
    campaign = campaigns.find_by_run(event.run)
    if campaign is None:
        return
    del campaigns.members[event.run], campaign.runs[event.run]
    campaign.reads.pop(event.run, None)
    results = campaign.results.pop(event.run, {})
    match event:
        case RunCompleted():
            campaign.completed += 1
            if not campaign.met_by and _meets_rule(campaign, results):
                campaign.met_by = event.run
        case RunFailed():
            campaign.failed += 1
        case RunCancelled():
            campaign.cancelled += 1
    note_due(campaigns, campaign)


def _meets_rule(campaign: Campaign, results: dict[str, Any]) -> bool:
    """Whether the results of a completed run fulfil the stop rule. A rule that cannot be evaluated is not
    fulfilled, for example if the step was left out."""
    until = campaign.terms.until
    if until is None:
        return False
    try:
        return holds(until, results)
    except ExpressionError:
        return False


def fold_action_requested(campaigns: Campaigns, event: ActionRequested, at: int) -> None:
    if event.run in campaigns.members:
        campaigns.clocks.setdefault(event.action, at)
        if event.together:
            campaigns.parts[event.action] = len(event.together)


def fold_action_ended(campaigns: Campaigns, event: ActionEnd, at: int) -> None:
    began = campaigns.clocks.pop(event.action, None)
    parts = campaigns.parts.pop(event.action, 1) if began is not None else 1
    campaign = campaigns.find_by_run(event.run)
    if campaign is None:
        return
    if began is not None:
        campaign.spent_ns += (at - began) // parts
    if isinstance(event, ActionSucceeded) or (isinstance(event, ActionReconciled) and event.effects == "all"):
        for key, step in campaign.reads.get(event.run, {}).items():
            if step == event.step:
                campaign.results.setdefault(event.run, {})[key] = event.result


def fold_step_unexpected(campaigns: Campaigns, event: StepUnexpected, at: int) -> None:
    campaign = campaigns.find_by_run(event.run)
    if campaign is not None:
        for key, step in campaign.reads.get(event.run, {}).items():
            if step == event.step:
                campaign.results.get(event.run, {}).pop(key, None)


def fold_resource_consumed(campaigns: Campaigns, event: ResourceConsumed, at: int) -> None:
    campaign = campaigns.find_by_run(event.run)
    if campaign is not None:
        campaign.used[event.resource] = campaign.used.get(event.resource, 0.0) + event.amount


def note_due(campaigns: Campaigns, campaign: Campaign) -> None:
    """Remember whether a campaign must be stopped or is over."""
    if explain_stop(campaign) or is_over(campaign):
        campaigns.due[campaign.id] = True
    else:
        campaigns.due.pop(campaign.id, None)
