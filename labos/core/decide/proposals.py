"""Approvals: a proposal waits for an operator, and a run with dangerous steps for a second person. The
answers, and the events that follow."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain

from labos.core.approvals import ApprovalGiven, ApprovalRefused, ApprovalRequested, Proposal, RunApproved
from labos.core.campaigns import CampaignAmended, CampaignCancelled, CampaignCompleted, CampaignStopped, Terms
from labos.core.decide._base import Command, Decision, Rejection, list_possible
from labos.core.decide.campaigns import CancelCampaign, cancel_campaign, check_terms
from labos.core.decide.cancelling import CancelRun, cancel_run
from labos.core.decide.control import CancelExperiment, cancel_experiment
from labos.core.decide.endings import record_end
from labos.core.decide.lookups import decides_about
from labos.core.experiments import ExperimentCancelled, ExperimentClosing, ExperimentEnded
from labos.core.ids import CampaignId, ExperimentId, RunId, local
from labos.core.interventions import InterventionResolved
from labos.core.open_experiments import Experiment
from labos.core.registry import Event
from labos.core.runs import RunCancelled, RunSubmitted
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.topics import Approval, SecondPerson, name_some
from labos.core.users import ON_BEHALF, find_person
from labos.core.words import Words

SHORTEST_DIGEST = 12
"""So many characters of a digest identify the content that the operator has seen."""

MOST_NAMED = 5
"""The question names at most this number of dangerous steps."""


class ApproveProposal(Command, frozen=True):
    """Approve the run, campaign, experiment or change ``subject`` with the content that has this ``digest``
    (or its beginning). ``priority`` (of a run or an experiment) and ``terms`` (of a campaign or its change)
    replace those of the submission. ``alike``: see ``ApprovalGiven``."""

    subject: str
    digest: str
    by: str
    why: Words = ""
    priority: int | None = None
    terms: Terms | None = None
    alike: bool = False


class RefuseProposal(Command, frozen=True):
    """Refuse a proposal."""

    subject: str
    by: str
    why: Words = ""


def _expect_proposal(state: LabState, command: ApproveProposal | RefuseProposal) -> Proposal | Rejection:
    found = state.approvals.open.get(command.subject)
    missing = f"{command.subject} does not wait for an approval."
    return found or Rejection("no_proposal", missing, "List what waits: labos approvals")


@decides_about(ApproveProposal, _expect_proposal)
def approve_proposal(state: LabState, command: ApproveProposal, proposal: Proposal) -> Decision:
    wrong = _check_as_seen(proposal, command.digest) or _check_changes(state, proposal, command)
    if wrong is not None:
        return wrong
    events = approve(state, proposal, command)
    if isinstance(events, Rejection):
        return events
    return chain(_resolve_question(state, proposal.subject, "approve", command.by, command.why), events)


@decides_about(RefuseProposal, _expect_proposal)
def refuse_proposal(state: LabState, command: RefuseProposal, proposal: Proposal) -> Decision:
    return chain(
        _resolve_question(state, proposal.subject, "refuse", command.by, command.why),
        refuse(state, proposal, command),
    )


def answer_question(state: LabState, topic: Approval, choice: str, by: str, note: str) -> Decision:
    """Answer a proposal through the question about it."""
    proposal = state.approvals.open.get(topic.about)
    if proposal is None:
        return []
    if choice != "approve":
        return refuse(state, proposal, RefuseProposal(topic.about, by, note))
    wrong = _check_as_seen(proposal, topic.digest)
    return wrong or approve(state, proposal, ApproveProposal(topic.about, topic.digest, by, note))


def approve(state: LabState, proposal: Proposal, command: ApproveProposal) -> Decision:
    wrong = _may_not_approve(state, proposal, command.by) or _check_experiment(state, proposal)
    return wrong or _give_approval(state, proposal, command)


def _give_approval(state: LabState, proposal: Proposal, command: ApproveProposal) -> Iterator[Event]:
    yield make_from(
        ApprovalGiven,
        command,
        subject=proposal.subject,
        kind=proposal.kind,
        digest=proposal.digest,
        comment=command.why,
    )
    if proposal.kind == "amendment" and proposal.terms is not None:
        yield CampaignAmended(CampaignId(proposal.subject), command.terms or proposal.terms)
    run = state.runs.queued.get(RunId(proposal.subject))
    if run is not None and run.unapproved and find_person(command.by) != run.user:
        yield RunApproved(run.id, command.by)
    if proposal.kind == "experiment":
        for waiting in list(_find_waiting(state, proposal.subject)):
            yield from _resolve_question(state, waiting.subject, "approve", command.by, command.why)
            yield ApprovalGiven(waiting.subject, "run", waiting.digest, command.by, command.why)


def refuse(state: LabState, proposal: Proposal, command: RefuseProposal) -> Iterator[Event]:
    subject, kind = proposal.subject, proposal.kind
    reason = f": {command.why}" if command.why else ""
    why = f"{command.by} did not approve it{reason}"
    yield ApprovalRefused(subject, kind, proposal.digest, command.by, command.why)
    follows: Decision = []
    if kind == "run":
        follows = cancel_run(state, CancelRun(RunId(subject), False, why))
    elif kind == "campaign":
        follows = cancel_campaign(state, CancelCampaign(CampaignId(subject), False, why))
    elif kind == "experiment":
        follows = cancel_experiment(
            state, CancelExperiment(ExperimentId(subject), command.by, False, command.why)
        )
    yield from list_possible(follows)


def _find_waiting(state: LabState, experiment: str) -> Iterator[Proposal]:
    """The runs of an experiment that wait only because the experiment is not approved."""
    known = state.experiments.open[ExperimentId(experiment)]
    for run in known.runs:
        proposal = state.approvals.open.get(run)
        if proposal is not None and proposal.codes == {"experiment"}:
            yield proposal


def _check_as_seen(proposal: Proposal, seen: str) -> Rejection | None:
    """Why an answer is not about the present content of the proposal."""
    if len(seen) >= SHORTEST_DIGEST and proposal.digest.startswith(seen):
        return None
    return Rejection(
        "changed",
        f"{proposal.subject} has changed since you checked it; its digest is now "
        f"{proposal.digest[:SHORTEST_DIGEST]}.",
        f"Check it again: labos approvals {proposal.subject}",
    )


def _check_changes(state: LabState, proposal: Proposal, command: ApproveProposal) -> Rejection | None:
    """Why a proposal cannot be approved with these changes."""
    of_table = proposal.kind in ("campaign", "amendment")
    wrong = (
        ("terms" if command.terms is not None and not of_table else "")
        or ("priority" if command.priority is not None and of_table else "")
        or ("alike" if command.alike and "experiment" not in proposal.parts else "")
    )
    if wrong:
        return Rejection(
            "no_such_change",
            f"{proposal.subject} cannot be approved with `{wrong}`.",
            "For runs and experiments you can set the priority, for campaigns the terms; only for a "
            "run of an experiment can you approve the following runs of the same kind.",
        )
    if command.terms is None:
        return None
    return check_terms(state.campaigns.open[CampaignId(proposal.subject)], command.terms)


def _may_not_approve(state: LabState, proposal: Proposal, by: str) -> Rejection | None:
    user = state.users.known.get(by)
    if ON_BEHALF in by or (user is not None and user.kind == "service"):
        return Rejection("no_person", f"{by} is not a person.", "Ask an operator to check it.")
    own = by in (proposal.user, find_person(proposal.by))
    if own and not state.approvals.policy.own:
        return Rejection(
            "own_approval",
            f"{proposal.subject} belongs to {by}, and the lab's policy requires the approval of "
            "another person.",
            "Ask another operator; or an admin allows it: `own: true` in the file of labos policy --apply",
        )
    return None


def _check_experiment(state: LabState, proposal: Proposal) -> Rejection | None:
    """Why a run cannot be approved before its experiment; None if it can."""
    experiment = proposal.parts.get("experiment", "") if proposal.kind == "run" else ""
    known: Experiment | None = state.experiments.open.get(ExperimentId(experiment))
    if known is None or not known.held:
        return None
    return Rejection(
        "experiment_first",
        f"The experiment {known.id} of {proposal.subject} also waits for an approval.",
        f"Approve that first: labos approve {known.id}",
    )


# -- the question --------------------------------------------------------------------------------


def _resolve_question(
    state: LabState, subject: str, choice: str, by: str, note: str
) -> Iterable[InterventionResolved]:
    """The question about a proposal is resolved together with it."""
    questions = state.interventions.list_about(subject, Approval)
    return [InterventionResolved(question.id, choice, by, note) for question in questions]


def answer_approval(state: LabState, topic: SecondPerson, choice: str, by: str) -> Decision:
    """A second person approves a run's dangerous steps, or refuses."""
    run = state.runs.queued.get(RunId(topic.run))
    if run is None:
        return []
    if choice != "approve":
        return record_end(state, run, RunCancelled(run.id, f"{by} did not approve it"), "was not approved")
    user = state.users.known.get(by)
    if find_person(by) == run.user:
        return Rejection(
            "second_person",
            f"{run.id} is a run of {run.user} and needs the approval of a second person.",
            "Ask another operator.",
        )
    if ON_BEHALF in by or (user is not None and user.kind == "service"):
        return Rejection("second_person", f"{by} is not a person.", "Ask an operator to check it.")
    return [RunApproved(run.id, by)]


# -- reactions -----------------------------------------------------------------------------------


def ask_for_approval(state: LabState, event: ApprovalRequested) -> Iterator[Event]:
    """An operator is asked, and an earlier question about the same subject is withdrawn."""
    for question in state.interventions.list_about(event.subject, Approval):
        yield question.withdraw("it was changed, and the question is asked again")
    what = {"amendment": "The change of campaign"}.get(event.kind, event.kind.capitalize())
    why = "; ".join(why.text for why in event.why)
    text = (
        f"{what} {event.subject} ({event.name}) of {event.user} waits for approval, because {why}. "
        f"Check it (labos approvals {event.subject})."
    )
    run = event.subject if event.kind == "run" else ""
    yield state.interventions.ask(
        Approval(run=run, about=event.subject, digest=event.digest, what=event.kind), text
    )


def withdraw_approval_question(
    state: LabState,
    event: CampaignCancelled
    | CampaignStopped
    | CampaignCompleted
    | ExperimentCancelled
    | ExperimentClosing
    | ExperimentEnded,
) -> Iterator[Event]:
    """The question about an approval is withdrawn when its subject has ended."""
    subject = event.campaign if hasattr(event, "campaign") else event.experiment
    for question in state.interventions.list_about(subject, Approval):
        yield question.withdraw("it has ended")


def ask_second_person(state: LabState, event: RunSubmitted | ApprovalGiven) -> Iterator[Event]:
    """A run with dangerous steps on modules that require a second person waits for an approval, unless it
    already waits for one."""
    name = event.run if isinstance(event, RunSubmitted) else RunId(event.subject)
    run = state.runs.queued.get(name)
    if run is None or not run.unapproved or run.held:
        return
    plans = (state.runs.plans[name] for name in run.choices or (run.plan,))
    steps = next([known.plan.steps[index] for index in known.dangers] for known in plans if known.dangers)
    named = [f"{step.key!r} on {local(step.module)} ({step.dangerous})" for step in steps]
    text = (
        f"Run {run.id} ({run.workflow}) of {run.user} has dangerous steps: {name_some(named, MOST_NAMED)}. "
        "It needs the approval of a second person."
    )
    yield state.interventions.ask(SecondPerson(run=run.id, module=steps[0].module), text)
