"""Campaigns and shares: a workflow for each row of a table, and each user's share of the lab."""

from __future__ import annotations

import msgspec
from starlette.responses import Response

from labos.core.campaigns import Campaign, Terms
from labos.core.decide.campaigns import (
    AmendCampaign,
    ArchiveCampaign,
    CancelCampaign,
    PauseCampaign,
    ResumeCampaign,
)
from labos.core.decide.shares import ApplyShares
from labos.core.ids import CampaignId
from labos.errors import NotFound
from labos.http import wire
from labos.http.bodies import (
    Amendment,
    Archiving,
    By,
    CampaignCancel,
    CampaignPause,
    Clone,
    NewCampaign,
    SharesFile,
)
from labos.http.campaigns import (
    CampaignView,
    Estimate,
    amend_terms,
    clone_campaign,
    make_view,
    submit_campaign,
)
from labos.http.limits import SMALL_BODY
from labos.http.operation import Call, Method, apply_file, change, read, submit
from labos.http.queries import OfCampaign
from labos.http.routes.runs import TIMED_WORKFLOW
from labos.services.proposals import describe_waiting
from labos.services.shares import ShareAccount, make_ledger
from labos.spec.shares import parse_shares


class CampaignSubmission(msgspec.Struct, frozen=True):
    """The id of the campaign (empty if it was only checked), and the work and material that all its rows
    need: the number of ``rows`` and of those that were ``checked``, ``module_time_s`` in total and by
    ``modules``, the least time that the ``busiest`` module needs (``bounds_s``), and the amount of each of
    the ``consumables`` that is ``needed`` and ``left``. ``approval`` is the reason if it waits for an
    approval."""

    campaign: str
    estimate: Estimate
    approval: str = ""


class CampaignReference(msgspec.Struct, frozen=True):
    campaign: str


class CampaignTerms(msgspec.Struct, frozen=True):
    """The terms that are now valid. ``approval`` is the reason if a change waits for an approval."""

    campaign: str
    terms: Terms
    approval: str = ""


class Campaigns(msgspec.Struct, frozen=True):
    campaigns: list[CampaignView]


class Shares(msgspec.Struct, frozen=True):
    """An account for each user who is in the shares file or has used the lab: the ``wanted`` share, the share
    that the user ``had``, ``lab_hours`` and ``consumables`` of the last seven days, and the ``quota``.
    """

    accounts: list[ShareAccount]


class SharesReference(msgspec.Struct, frozen=True):
    """The SHA-256 of the file."""

    digest: str


CAMPAIGN = {
    "text": "labos: 1\ncampaign: sealing times\nworkflow: seal.yaml\n"
    "rows: {list: [{time: 2.0}, {time: 3.0}]}\n",
    "workflow": TIMED_WORKFLOW,
    "user": "ada",
}
"""A campaign for examples."""

_SHARES = "labos: 1\ngroups:\n  chemistry: {weight: 2, members: {ada: {}}}\n"


@read(
    route="GET /campaigns",
    client=Method("campaigns", take="campaigns"),
    summary="List the campaigns that have not been completed",
)
def list_campaigns(call: Call) -> Campaigns:
    state = call.kernel.state
    return Campaigns([make_view(state, c) for c in state.campaigns.open.values() if c.id not in call.hidden])


@submit(
    route="POST /campaigns",
    client=Method("submit_campaign", by_hand=True),
    summary="Check a campaign and submit it",
    status=201,
    other_statuses={200: "It was only checked (`dry_run`)"},
    logs_key=True,
    example={**CAMPAIGN, "dry_run": True},
    answer=CampaignSubmission,
)
async def submit_campaign_file(call: Call, body: NewCampaign) -> Response:
    """The campaign is checked row by row. If a row cannot be carried out, nothing is submitted, and `details`
    of the problem lists each fault with its row."""
    name, estimate = await submit_campaign(call.service, body, call.key)
    submission = CampaignSubmission(name, estimate, describe_waiting(call.kernel.state, name))
    return wire.answer(submission, 200 if body.dry_run else 201)


@read(
    route="GET /campaigns/{campaign}",
    client=Method("campaign"),
    summary="Show the progress and the terms of a campaign that has not been completed",
)
def get_campaign(call: Call, path: OfCampaign) -> CampaignView:
    return make_view(call.kernel.state, _open_campaign(call, path))


@change(
    route="POST /campaigns/{campaign}/pause",
    client=Method("pause_campaign", take=None, repeat=True),
    summary="Pause a campaign: no further row is submitted",
    example={"by": "ada", "why": "lunch"},
    example_answer={"campaign": "C1"},
)
async def pause_campaign(call: Call, path: OfCampaign, body: CampaignPause) -> CampaignReference:
    """Its waiting runs are paused; runs that have started continue."""
    name = _open_campaign(call, path).id
    await call.kernel.execute(PauseCampaign(name, body.why), body.by)
    return CampaignReference(name)


@change(
    route="POST /campaigns/{campaign}/resume",
    client=Method("resume_campaign", take=None, repeat=True),
    summary="Resume a paused campaign",
    example={"by": "ada"},
    example_answer={"campaign": "C1"},
)
async def resume_campaign(call: Call, path: OfCampaign, body: By) -> CampaignReference:
    name = _open_campaign(call, path).id
    await call.kernel.execute(ResumeCampaign(name), body.by)
    return CampaignReference(name)


@change(
    route="POST /campaigns/{campaign}/cancel",
    client=Method("cancel_campaign", take=None, repeat=True),
    summary="Cancel a campaign",
    example={"by": "ada", "why": "wrong plates"},
    example_answer={"campaign": "C1"},
)
async def cancel_campaign(call: Call, path: OfCampaign, body: CampaignCancel) -> CampaignReference:
    """No further row is submitted, and its runs are cancelled."""
    name = _open_campaign(call, path).id
    await call.kernel.execute(CancelCampaign(name, body.stay, body.why), body.by)
    return CampaignReference(name)


@change(
    route="POST /campaigns/{campaign}/amend",
    client=Method("_amend_campaign", repeat=True),
    summary="Change the terms of a campaign",
    problems=("refused", "spec_error"),
    example={"by": "ada", "priority": 5, "runs": 100},
)
async def amend_campaign(call: Call, path: OfCampaign, body: Amendment) -> CampaignTerms:
    """Fields that are left out do not change. A change that allows the campaign more may need an approval;
    until then, the terms in the answer are valid."""
    campaign = _open_campaign(call, path)
    terms = amend_terms(campaign.terms, body, call.kernel.clock.now_ns())
    await call.kernel.execute(AmendCampaign(campaign.id, terms), body.by)
    return CampaignTerms(campaign.id, campaign.terms, describe_waiting(call.kernel.state, campaign.id))


@submit(
    route="POST /campaigns/{campaign}/clone",
    client=Method("_clone_a_campaign", key="given", timeout_s=900.0),
    summary="Submit a copy of a campaign",
    status=201,
    other_statuses={200: "It was only checked (`dry_run`)"},
    logs_key=True,
    example={"by": "ada", "name": "sealing times, again", "deadline": "36h", "dry_run": True},
    answer=CampaignSubmission,
    largest_body=SMALL_BODY,
)
async def clone_a_campaign(call: Call, path: OfCampaign, body: Clone) -> Response:
    """The copy has the same rows and the same workflow, and is checked like a new campaign. It belongs to the
    user who asks. A campaign that has ended can be copied too. Fields that are left out are as in the
    original, except the deadline: the copy has none."""
    call.expect_seen(path.campaign)
    name, estimate = await clone_campaign(call.service, path.campaign, body, body.by, call.key)
    submission = CampaignSubmission(name, estimate, describe_waiting(call.kernel.state, name))
    return wire.answer(submission, 200 if body.dry_run else 201)


@change(
    route="POST /campaigns/{campaign}/archive",
    client=Method("archive_campaign", take=None, repeat=True),
    summary="Hide a campaign that has ended from lists",
    problems=("not_found", "refused"),
    example={"by": "ada"},
    example_answer={"campaign": "C1"},
)
async def archive_campaign(call: Call, path: OfCampaign, body: Archiving) -> CampaignReference:
    """Nothing is deleted."""
    call.expect_seen(path.campaign)
    await call.kernel.execute(ArchiveCampaign(CampaignId(path.campaign), body.undo), body.by)
    return CampaignReference(path.campaign)


@read(
    route="GET /shares",
    client=Method("shares", take="accounts"),
    summary="Show each user's share of the lab, and the use so far",
)
def list_shares(call: Call) -> Shares:
    return Shares(make_ledger(call.kernel.state, call.kernel.clock.now_ns()))


@apply_file(
    route="POST /shares",
    client=Method("apply_shares", "text, file=name, by", take=None, repeat=True),
    summary="Apply a shares file with weights and quotas",
    example={"text": _SHARES, "by": "ada", "name": "shares.yaml"},
    example_answer={"digest": "ab" * 32},
)
async def apply_shares(call: Call, body: SharesFile) -> SharesReference:
    found = await call.service.run_beside(len(body.text), parse_shares, body.text, body.name)
    await call.kernel.execute(ApplyShares(found.digest, found.groups, found.users), body.by)
    return SharesReference(found.digest)


def _open_campaign(call: Call, path: OfCampaign) -> Campaign:
    """Raises NotFound."""
    known = call.kernel.state.campaigns.open.get(CampaignId(path.campaign))
    if known is None or known.id in call.hidden:
        raise NotFound(
            f"There is no campaign {path.campaign!r} that has not ended.",
            remedy="See its history: labos campaign show",
        )
    return known
