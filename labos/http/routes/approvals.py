"""Submissions that wait for an approval, and the policy that requires approvals."""

from __future__ import annotations

import asyncio
from typing import Annotated

import msgspec

from labos.core.approvals import Demand, Proposal, Why
from labos.core.campaigns import Terms
from labos.core.decide.proposals import ApproveProposal, RefuseProposal
from labos.core.decide.submissions import ApplyPolicy
from labos.core.decide.targets import cells_of
from labos.core.ids import CampaignId
from labos.core.policy import Policy
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.errors import BadInput, NotFound
from labos.http.bodies import Amendment, Amounts, Asked, Limit
from labos.http.campaigns import ConsumableEstimate, amend_terms, estimate_consumables
from labos.http.limits import Amount, Asker, FileName, FileText, Line, Name, Priority, says
from labos.http.operation import Call, Method, apply_file, operate, read
from labos.http.routes.forecasts import FORECAST_S, hide_others
from labos.http.tail import PAGE
from labos.planning.lab_forecast import LabForecast
from labos.services.proposals import ChangedPart, describe_waiting, list_differences
from labos.spec.policy import parse_policy


class OfProposal(msgspec.Struct, frozen=True):
    subject: Annotated[Name, says("the run, campaign or experiment that waits", "R1")]


class ProposalView(msgspec.Struct, frozen=True):
    """A run, campaign or experiment (``subject``) that waits for an approval, or a change of a campaign
    (``amendment``). ``digest`` covers all its ``parts``; the approval is for this digest. ``by`` submitted it
    for ``user``. ``demand`` is the work and material that its plan needs. ``before`` is the last approved
    submission with the same ``name``, from which the parts ``changed`` differ. ``terms`` are the terms of a
    campaign after the approval."""

    subject: str
    kind: str
    name: str
    user: str
    by: str
    digest: str
    why: tuple[Why, ...]
    sentence: str
    requested_at: int
    demand: Demand
    parts: dict[str, str]
    before: str
    changed: tuple[str, ...]
    terms: Terms | None


class ProposalsQuery(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    after: Annotated[Name, says("only submissions after this one; all of them if it no longer waits")] = ""
    limit: Annotated[
        int, msgspec.Meta(ge=1, le=PAGE), says("the largest number in an answer; 100 if left out")
    ] = 100


class Proposals(msgspec.Struct, frozen=True):
    """A page of proposals. ``more``: there are others after the last one."""

    approvals: list[ProposalView]
    more: bool


class ProposalDetail(msgspec.Struct, frozen=True):
    """A proposal, and how it differs from the last approved one of the same name."""

    proposal: ProposalView
    differences: list[ChangedPart]


class ProposalForecast(msgspec.Struct, frozen=True):
    """The forecast for a proposal: its start and end, the times when a person is needed, the runs that it
    delays, the obstacles, and for each consumable the amount that its plan needs and the amount that is
    left."""

    forecast: LabForecast
    consumables: dict[str, ConsumableEstimate]


class ProposalAnswer(msgspec.Struct, frozen=True):
    """The subject, and the digest that was approved or refused."""

    subject: str
    digest: str


class PolicyView(msgspec.Struct, frozen=True):
    """The present policy. ``applied`` is the SHA-256 of its file, empty if there is none."""

    applied: str
    policy: Policy


class ApprovalTerms(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Fields that are left out stay as requested. The terms are those of campaigns and of their changes; the
    priority is also that of a run or an experiment."""

    digest: Annotated[
        Name,
        says("the digest of the submission that the operator looked at; the first 12 characters are enough"),
    ]
    by: Asker = ""
    comment: Annotated[Line, says("a reason or comment for the log")] = ""
    priority: Annotated[Priority | None, says("a priority that replaces the requested one")] = None
    deadline: Annotated[Line | None, says("a time, or a duration from now (`12h`); empty for none")] = None
    runs: Annotated[Limit | None, says("the largest number of runs; 0 for no limit")] = None
    lab_time_s: Annotated[Amount | None, says("the most module time, in lab seconds; 0 for no limit")] = None
    consumables: Annotated[Amounts | None, says("the largest amounts, by kind of consumable")] = None
    alike: Annotated[
        bool,
        says("for a run of an experiment: further runs of its workflow there need no approval"),
    ] = False


class ApprovalRefusal(Asked, kw_only=True):
    comment: Annotated[Line, says("a reason or comment for the log")] = ""


class PolicyText(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    text: Annotated[FileText, says("the file")]
    by: Asker = ""
    name: Annotated[FileName, says("the name of the file in error messages")] = "policy"


class PolicyReference(msgspec.Struct, frozen=True):
    """The SHA-256 of the file."""

    digest: str


_POLICY = "labos: 1\ntrusted: [lims]\nnewcomers: 3\nabove: {lab_time: 40 h}\n"


@read(
    route="GET /approvals",
    client=Method("approvals", by_hand=True),
    summary="List the submissions that wait for an approval",
)
def list_approvals(call: Call, query: ProposalsQuery) -> Proposals:
    """A page of them, the oldest first. While there are `more`, ask for the next page with `after` = the last
    `subject`."""
    state = call.kernel.state
    names = [name for name in state.approvals.open if name not in call.hidden]
    begin = names.index(query.after) + 1 if query.after in names else 0
    shown = names[begin : begin + query.limit]
    found = [_make_view(state, state.approvals.open[name]) for name in shown]
    return Proposals(found, begin + query.limit < len(names))


@read(
    route="GET /approvals/{subject}",
    client=Method("approval_of"),
    summary="Show a submission that waits for an approval, and how it differs from the last approved one",
)
async def get_approval(call: Call, path: OfProposal) -> ProposalDetail:
    state = call.kernel.state
    proposal = _find_proposal(call, path)
    view = _make_view(state, proposal)
    await call.kernel.flush()
    parts = call.service.parts
    changed = await asyncio.to_thread(list_differences, parts.store, parts.blobs, state, proposal)
    return ProposalDetail(view, changed)


@read(
    route="GET /approvals/{subject}/forecast",
    client=Method("approval_forecast", timeout_s=FORECAST_S),
    summary="Forecast a submission that waits for an approval",
    problems=("refused",),
)
async def forecast_approval(call: Call, path: OfProposal) -> ProposalForecast:
    """The forecast assumes that the submission is approved now, without changes. This does not approve it. An
    experiment cannot be forecast, because its application decides while it runs."""
    proposal = _find_proposal(call, path)
    if proposal.kind == "experiment":
        raise BadInput(
            f"There is no forecast for the experiment {proposal.subject}, because its application decides "
            "during the experiment.",
            remedy="Each of its runs waits for an approval. Check those.",
        )
    (cell,) = cells_of(call.kernel.state, proposal.subject)
    consumables = estimate_consumables(call.service, cell, proposal.demand.consumables)
    forecast = await call.service.forecasts.forecast(approved=proposal.subject)
    return ProposalForecast(hide_others(forecast, call), consumables)


@operate(
    route="POST /approvals/{subject}/approve",
    client=Method("approve", "subject, by, digest", take="digest", repeat=True),
    summary="Approve a submission, as it is or with changes",
    example={"by": "olga", "digest": "ab" * 32, "comment": "looked at it", "runs": 20},
    example_answer={"subject": "C1", "digest": "ab" * 32},
)
async def approve_proposal(call: Call, path: OfProposal, body: ApprovalTerms) -> ProposalAnswer:
    """Only the submission with this digest can be approved: the request is refused if the submission has
    changed since the operator looked at it. An operator approves; the policy says whether it may be the
    submitting user. A program cannot approve."""
    proposal = _find_proposal(call, path)
    priority, terms = _read_changes(call, proposal, body)
    changes = {"priority": priority, "terms": terms}
    command = make_from(ApproveProposal, body, subject=proposal.subject, why=body.comment, **changes)
    digest = proposal.digest
    await call.kernel.execute(command, body.by)
    return ProposalAnswer(proposal.subject, digest)


def _read_changes(call: Call, proposal: Proposal, body: ApprovalTerms) -> tuple[int | None, Terms | None]:
    """The changes that the operator makes to the requested terms. Raises BadInput."""
    if proposal.kind in ("run", "experiment") and (body.deadline, body.runs, body.lab_time_s) == (None,) * 3:
        return body.priority, None
    wanted = make_from(Amendment, body)
    asked = _find_terms(call.kernel.state, proposal) or Terms()
    terms = amend_terms(asked, wanted, call.kernel.clock.now_ns())
    return None, terms if terms != asked or proposal.kind in ("run", "experiment") else None


@operate(
    route="POST /approvals/{subject}/refuse",
    client=Method("refuse", take="digest", repeat=True),
    summary="Refuse a submission",
    example={"by": "olga", "comment": "too many plates"},
    example_answer={"subject": "C1", "digest": "ab" * 32},
)
async def refuse_proposal(call: Call, path: OfProposal, body: ApprovalRefusal) -> ProposalAnswer:
    """The submission is cancelled. If it is a change of a campaign, the campaign continues unchanged."""
    proposal = _find_proposal(call, path)
    digest = proposal.digest
    await call.kernel.execute(RefuseProposal(proposal.subject, body.by, body.comment), body.by)
    return ProposalAnswer(proposal.subject, digest)


@read(
    route="GET /policy",
    client=Method("policy"),
    summary="Show the policy: which submissions need an approval, and the highest priority",
)
def get_policy(call: Call) -> PolicyView:
    approvals = call.kernel.state.approvals
    return PolicyView(approvals.applied, approvals.policy)


@apply_file(
    route="POST /policy",
    client=Method("apply_policy", "text, file=name, by", take=None, repeat=True),
    summary="Apply a policy file",
    example={"text": _POLICY, "by": "ada", "name": "policy.yaml"},
    example_answer={"digest": "ab" * 32},
)
async def apply_policy(call: Call, body: PolicyText) -> PolicyReference:
    """Submissions that wait already continue to wait."""
    found = await call.service.run_beside(len(body.text), parse_policy, body.text, body.name)
    await call.kernel.execute(ApplyPolicy(found.digest, found.policy), body.by)
    return PolicyReference(found.digest)


def _find_proposal(call: Call, path: OfProposal) -> Proposal:
    """Raises NotFound."""
    found = call.kernel.state.approvals.open.get(path.subject)
    if found is None or path.subject in call.hidden:
        raise NotFound(
            f"{path.subject} does not wait for an approval.", remedy="List what waits: labos approvals"
        )
    return found


def _make_view(state: LabState, proposal: Proposal) -> ProposalView:
    sentence = describe_waiting(state, proposal.subject)
    return make_from(ProposalView, proposal, sentence=sentence, terms=_find_terms(state, proposal))


def _find_terms(state: LabState, proposal: Proposal) -> Terms | None:
    """The terms of a campaign after the approval; None for a submission without terms."""
    campaign = state.campaigns.open.get(CampaignId(proposal.subject))
    return proposal.terms or (campaign.terms if campaign is not None else None)
