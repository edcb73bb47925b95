"""Approvals: submissions that wait until another person has checked them, and the contents that were approved
before.

A submission that waits is a *proposal*. It has a digest of all its contents, and an approval is for this
digest. There are two kinds of approval. The lab's policy demands one kind (``ApprovalRequested``), for runs,
campaigns, experiments and changes of campaigns. The other kind is given by a second person, for runs with
dangerous steps (``RunApproved``).
"""

from __future__ import annotations

from typing import Literal

import msgspec

from labos.core.campaigns import (
    CampaignCancelled,
    CampaignCompleted,
    Campaigns,
    CampaignStatus,
    CampaignStopped,
    Terms,
    note_due,
)
from labos.core.canonical import digest, encode_canonical
from labos.core.experiments import ExperimentCancelled, ExperimentClosing, ExperimentEnded
from labos.core.ids import CampaignId, ExperimentId, RunId
from labos.core.open_experiments import Experiments
from labos.core.policy import Policy, PolicyApplied
from labos.core.registry import Event, event
from labos.core.runs import RunEnd, RunEvent, Runs, requeue
from labos.core.structs import make_from
from labos.core.words import Words

PAST_KEPT = 1_000
"""The last approval is remembered for at most this number of names."""

Kind = Literal["run", "campaign", "experiment", "amendment"]


class Why(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A reason why something waits for an approval: a ``code`` for programs, a ``text`` for people."""

    code: str
    text: str


class Demand(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The work and material that a submission needs by its plan. It has the number of steps; nominal module
    time in lab seconds, in total and by module; consumables by kind; its dangerous steps. For a campaign,
    these are the sums over all its ``rows``."""

    steps: int = 0
    module_time_s: float = 0.0
    modules: dict[str, float] = {}
    consumables: dict[str, float] = {}
    dangers: tuple[str, ...] = ()
    rows: int = 0


class ApprovalEvent(Event, frozen=True):
    """``subject`` is a run, a campaign or an experiment."""

    STREAM = "subject"
    subject: str


@event("approval.requested")
class ApprovalRequested(ApprovalEvent, frozen=True):
    """A submission, or a change of a campaign (``amendment``), waits for an approval. ``digest`` covers all
    its ``parts``, which are digests by name. ``by`` is the user who asked. ``before`` is the last approved
    digest of the same name, and ``changed`` lists the parts that differ from it. ``terms`` are those of a
    campaign."""

    kind: Kind
    name: str
    user: str
    by: str
    digest: str
    why: tuple[Why, ...]
    parts: dict[str, str]
    demand: Demand = Demand()
    before: str = ""
    changed: tuple[str, ...] = ()
    terms: Terms | None = None


@event("approval.given")
class ApprovalGiven(ApprovalEvent, frozen=True):
    """An operator approves exactly this content (``digest``). If ``priority`` or ``terms`` are given, they
    replace those of the submission. With ``alike``, further runs of the same experiment with the same
    workflow need no approval for the reason that a program or a newcomer submits them."""

    kind: Kind
    digest: str
    by: str
    comment: Words = ""
    priority: int | None = None
    terms: Terms | None = None
    alike: bool = False


@event("approval.refused")
class ApprovalRefused(ApprovalEvent, frozen=True):
    """An operator refuses. The submission is cancelled, or the change of the campaign is not made."""

    kind: Kind
    digest: str
    by: str
    comment: Words = ""


@event("run.approved")
class RunApproved(RunEvent, frozen=True):
    """The run's dangerous steps may be carried out. ``by`` is a person other than the run's owner, and has
    checked the steps."""

    by: str


class Proposal(ApprovalRequested, frozen=True):
    """A submission that waits for an approval since ``requested_at`` (UTC ns)."""

    requested_at: int = 0

    @property
    def codes(self) -> set[str]:
        return {why.code for why in self.why}


class Approvals(msgspec.Struct):
    """``open`` are the proposals by subject. ``past`` are the last approved ones by kind and name. ``given``
    counts the approvals of each user's submissions. ``alike`` are, by experiment, the workflows (by
    ``take_common_parts``) whose further runs need no approval. ``applied`` is the digest of the policy's
    file."""

    policy: Policy = Policy()
    applied: str = ""
    open: dict[str, Proposal] = {}
    past: dict[str, Proposal] = {}
    given: dict[str, int] = {}
    alike: dict[str, dict[str, bool]] = {}

    def find_last(self, kind: Kind, name: str) -> Proposal | None:
        """The last approved proposal of a kind and name."""
        return self.past.get(f"{kind}:{name}")


VALUES = ("plan", "payload")
"""Parts of a run that differ between runs of one workflow."""


def take_common_parts(parts: dict[str, str]) -> str:
    """The digest of the parts that two runs of one workflow have in common if they differ in their values
    only."""
    return "\n".join(f"{name}={parts[name]}" for name in sorted(parts) if name not in VALUES)


def fold_policy_applied(approvals: Approvals, event: PolicyApplied, at: int) -> None:
    approvals.policy, approvals.applied = event.policy, event.digest


def fold_approval_requested(approvals: Approvals, event: ApprovalRequested, at: int) -> None:
    approvals.open.pop(event.subject, None)
    approvals.open[event.subject] = make_from(Proposal, event, requested_at=at)


def fold_approval_given(approvals: Approvals, event: ApprovalGiven, at: int) -> None:
    proposal = approvals.open.pop(event.subject)
    key = f"{proposal.kind}:{proposal.name}"
    approvals.past.pop(key, None)
    terms = event.terms or proposal.terms
    changed = {"terms": digest(encode_canonical(terms))} if event.terms is not None else {}
    approvals.past[key] = msgspec.structs.replace(proposal, parts=proposal.parts | changed, terms=terms)
    while len(approvals.past) > PAST_KEPT:
        del approvals.past[next(iter(approvals.past))]
    approvals.given[proposal.user] = approvals.given.get(proposal.user, 0) + 1
    experiment = proposal.parts.get("experiment", "")
    if event.alike and experiment:
        approvals.alike.setdefault(experiment, {})[take_common_parts(proposal.parts)] = True


def fold_approval_refused(approvals: Approvals, event: ApprovalRefused, at: int) -> None:
    del approvals.open[event.subject]


def fold_run_ended(approvals: Approvals, event: RunEnd, at: int) -> None:
    approvals.open.pop(event.run, None)


def fold_campaign_ended(
    approvals: Approvals, event: CampaignCancelled | CampaignStopped | CampaignCompleted, at: int
) -> None:
    approvals.open.pop(event.campaign, None)


def fold_experiment_ended(
    approvals: Approvals, event: ExperimentCancelled | ExperimentClosing | ExperimentEnded, at: int
) -> None:
    approvals.open.pop(event.experiment, None)
    if isinstance(event, ExperimentEnded):
        approvals.alike.pop(event.experiment, None)


# -- what waits ----------------------------------------------------------------------------------


def fold_run_approved(runs: Runs, event: RunApproved, at: int) -> None:
    run = runs.queued[event.run]
    with requeue(runs, run):
        run.unapproved = False


def fold_approval_requested_into_runs(runs: Runs, event: ApprovalRequested, at: int) -> None:
    if event.kind == "run":
        run = runs.queued[RunId(event.subject)]
        with requeue(runs, run):
            run.held = True


def fold_approval_given_into_runs(runs: Runs, event: ApprovalGiven, at: int) -> None:
    if event.kind == "run":
        run = runs.queued[RunId(event.subject)]
        with requeue(runs, run):
            run.held = False
            run.priority = run.priority if event.priority is None else event.priority


def fold_approval_requested_into_campaigns(campaigns: Campaigns, event: ApprovalRequested, at: int) -> None:
    if event.kind == "campaign":
        campaigns.open[CampaignId(event.subject)].status = CampaignStatus.PROPOSED
        campaigns.open[CampaignId(event.subject)].danger_seen = bool(event.demand.dangers)


def fold_approval_given_into_campaigns(campaigns: Campaigns, event: ApprovalGiven, at: int) -> None:
    if event.kind == "campaign":
        campaign = campaigns.open[CampaignId(event.subject)]
        campaign.status = CampaignStatus.OPEN
        campaign.terms = event.terms or campaign.terms
        note_due(campaigns, campaign)


def fold_approval_requested_into_experiments(
    experiments: Experiments, event: ApprovalRequested, at: int
) -> None:
    if event.kind == "experiment":
        experiments.open[ExperimentId(event.subject)].held = True


def fold_approval_given_into_experiments(experiments: Experiments, event: ApprovalGiven, at: int) -> None:
    if event.kind == "experiment":
        experiment = experiments.open[ExperimentId(event.subject)]
        experiment.held = False
        experiment.priority = experiment.priority if event.priority is None else event.priority
