"""Submissions that wait for an operator's approval, and what follows from the answer.

Every submission passes ``considered`` once it is decided, whoever hands it in by which way. What a plan does
to the bench is not judged here: an approved run waits for its turn as any other.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain
from typing import Any

import msgspec

from labos.core.approvals import (
    ApprovalGiven,
    ApprovalRefused,
    ApprovalRequested,
    Demand,
    Proposal,
    RunApproved,
    Why,
)
from labos.core.campaigns import (
    CampaignAmended,
    CampaignCancelled,
    CampaignCompleted,
    CampaignStopped,
    Terms,
)
from labos.core.canonical import canonical, digest
from labos.core.decide._base import Command, Decision, Rejection, decides
from labos.core.decide.campaigns import (
    AmendCampaign,
    CancelCampaign,
    SubmitCampaign,
    SubmitRow,
    cancel_campaign,
    unfit_terms,
)
from labos.core.decide.cancelling import CancelRun, cancel_run
from labos.core.decide.control import CancelExperiment, cancel_experiment
from labos.core.decide.experiments import StartExperiment
from labos.core.decide.holding_back import (
    Submission,
    dangers_of,
    demand_of,
    reasons_for,
    service_of,
    too_high,
)
from labos.core.decide.runs import SubmitRun
from labos.core.experiments import ExperimentCancelled, ExperimentClosing, ExperimentEnded, ExperimentStarted
from labos.core.ids import CampaignId, ExperimentId, RunId
from labos.core.interventions import Intervention, InterventionResolved
from labos.core.open_experiments import Experiment
from labos.core.policy import Policy, PolicyApplied
from labos.core.registry import Event
from labos.core.runs import RunSubmitted
from labos.core.state import LabState
from labos.core.topics import Approval
from labos.core.users import ON_BEHALF, person_of

SHORTEST_DIGEST = 12
"""Characters of a digest that are enough to say what was looked at."""


class ApplyPolicy(Command, frozen=True):
    """From now on this policy holds, as a file of that ``digest`` says."""

    digest: str
    policy: Policy


class ApproveProposal(Command, frozen=True):
    """Let the run, campaign, experiment or change ``subject`` go on, as it was when it had this ``digest``
    (or its beginning). ``priority`` of a run or an experiment, ``terms`` of a campaign or its change are in
    place of what was asked. ``alike``: see ``ApprovalGiven``."""

    subject: str
    digest: str
    by: str
    why: str = ""
    priority: int | None = None
    terms: Terms | None = None
    alike: bool = False


class RefuseProposal(Command, frozen=True):
    """Do not let it go on."""

    subject: str
    by: str
    why: str = ""


@decides(ApplyPolicy)
def apply_policy(state: LabState, command: ApplyPolicy) -> Decision:
    if (state.approvals.applied, state.approvals.policy) == (command.digest, command.policy):
        return []
    return [PolicyApplied(command.digest, command.policy)]


def attributed(command: Command, actor: str) -> Command:
    """The command as it is recorded: what a service account says for a person is put down to both, so that
    nobody takes it for the person's own word."""
    is_said = ON_BEHALF in actor and getattr(command, "by", "") == person_of(actor)
    return msgspec.structs.replace(command, by=actor) if is_said else command


# -- at the door ---------------------------------------------------------------------------------


def considered(state: LabState, command: Command, decision: Decision, actor: str) -> Decision:
    """What is decided of a submission of ``actor``, with the request for an approval if it takes one."""
    if not isinstance(command, _CONSIDERED) or isinstance(decision, Rejection):
        return decision
    if isinstance(command, ApplyPolicy):
        return _not_by_program(state, actor) or decision
    events = list(decision)
    if not events:
        return events  # it is known already
    if isinstance(command, SubmitRow):
        return _of_row(state, command, events)
    high = too_high(state, command, actor)
    if high is not None:
        return high
    match command:
        case SubmitRun():
            request = _of_run(state, command, events, actor)
        case SubmitCampaign():
            request = _of_campaign(state, command, events, actor)
        case StartExperiment():
            request = _of_experiment(state, command, events, actor)
        case AmendCampaign():
            return _of_amendment(state, command, events, actor)
    return [*events, *([request] if request is not None else [])]


_CONSIDERED = (ApplyPolicy, SubmitRun, SubmitCampaign, StartExperiment, AmendCampaign, SubmitRow)


def _not_by_program(state: LabState, actor: str) -> Rejection | None:
    """Why a policy is not changed: no program lets its own submissions go on."""
    service = service_of(state, actor)
    if not service:
        return None
    return Rejection("no_person", f"{service} is a program, and changes no policy.", "Ask an admin to do it.")


def _of_run(state: LabState, command: SubmitRun, events: list[Event], actor: str) -> ApprovalRequested | None:
    event = next(event for event in events if isinstance(event, RunSubmitted))
    pins = {name: value for name, value in event.pins.items() if name != "request"}
    parts = {
        **pins,
        **{f"file:{name}": value for name, value in command.plan.files.items()},
        "plan": event.plan,
        "payload": _digest_of(event.payload),
        **({"experiment": event.experiment} if event.experiment else {}),
    }
    asked = Submission(event.user, command.plan.workcell, demand_of([command.plan]), command.propose)
    why = reasons_for(state, asked, actor, parts=parts)
    return _request(state, event.run, "run", event.workflow, asked, actor, why, parts, [event.priority])


def _of_campaign(
    state: LabState, command: SubmitCampaign, events: list[Event], actor: str
) -> ApprovalRequested | None:
    name = f"C{state.campaigns.named + 1}"
    demand = msgspec.structs.replace(command.demand, rows=command.rows)
    asked = Submission(command.user, command.workcell, demand, command.propose, command.terms)
    why = reasons_for(state, asked, actor)
    return _of_table(state, name, command, asked, actor, why)


def _of_table(
    state: LabState,
    name: str,
    of: SubmitCampaign,
    asked: Submission,
    actor: str,
    why: tuple[Why, ...],
) -> ApprovalRequested | None:
    parts = {"workflow": of.definition, "table": of.table, "terms": _digest_of(of.terms)}
    return _request(state, name, "campaign", of.name, asked, actor, why, parts, [], of.terms)


def _of_experiment(
    state: LabState, command: StartExperiment, events: list[Event], actor: str
) -> ApprovalRequested | None:
    event = next(event for event in events if isinstance(event, ExperimentStarted))
    plan = command.closing
    demand = demand_of([plan] if plan is not None else [])
    asked = Submission(command.user, plan.workcell if plan is not None else "", demand, command.propose)
    why = reasons_for(state, asked, actor)
    parts = {"closing": event.closing, "parking": digest(canonical(list(event.parking)))}
    return _request(
        state, event.experiment, "experiment", event.name, asked, actor, why, parts, [event.priority]
    )


def _of_amendment(state: LabState, command: AmendCampaign, events: list[Event], actor: str) -> Decision:
    """A campaign that waits for an approval waits anew under its new terms. Of one that goes on, a change by
    which it may do more waits, and the campaign goes on as before."""
    campaign = state.campaigns.open[command.campaign]
    waiting = state.approvals.open.get(campaign.id)
    if waiting is not None and waiting.kind == "campaign":
        parts = {**waiting.parts, "terms": _digest_of(command.terms)}
        asked = Submission(campaign.user, campaign.workcell, waiting.demand)
        again = _request(
            *(state, campaign.id, "campaign", campaign.name, asked, waiting.by, waiting.why),
            *(parts, [], command.terms),
        )
        return [*events, *([again] if again is not None else [])]
    if not more_than(campaign.terms, command.terms):
        return events
    demand = Demand(rows=campaign.rows)
    asked = Submission(campaign.user, campaign.workcell, demand, False, command.terms, campaign.terms)
    why = reasons_for(state, asked, actor)
    parts = {
        "workflow": campaign.definition,
        "table": campaign.table,
        "terms": _digest_of(command.terms),
    }
    request = _request(
        state, campaign.id, "amendment", campaign.name, asked, actor, why, parts, [], command.terms
    )
    return events if request is None else [request]


def _of_row(state: LabState, command: SubmitRow, events: list[Event]) -> list[Event]:
    """A campaign waits for an approval before a row that does something dangerous, if nobody knew of that
    when it was submitted, or approved."""
    campaign = state.campaigns.open[command.campaign]
    dangers = dangers_of(command.plan)
    if not dangers or campaign.danger_seen or not any(isinstance(e, RunSubmitted) for e in events):
        return events
    demand = Demand(dangers=dangers, rows=campaign.rows)
    asked = Submission(campaign.user, campaign.workcell, demand, False, campaign.terms)
    why = tuple(why for why in reasons_for(state, asked, campaign.user) if why.code == "dangerous")
    parts = {
        "workflow": campaign.definition,
        "table": campaign.table,
        "terms": _digest_of(campaign.terms),
    }
    request = _request(
        state, campaign.id, "campaign", campaign.name, asked, campaign.user, why, parts, [], campaign.terms
    )
    return events if request is None else [request]


def more_than(old: Terms, new: Terms) -> bool:
    """Whether a campaign may do more, or go sooner, under new terms than under the old ones."""
    budget, was = new.budget, old.budget
    kinds = {*budget.consumables, *was.consumables}
    none = float("inf")
    return (
        (budget.runs or none) > (was.runs or none)
        or (budget.lab_time_s or none) > (was.lab_time_s or none)
        or any(budget.consumables.get(k, none) > was.consumables.get(k, none) for k in kinds)
        or new.priority > old.priority
        or (new.deadline or none) < (old.deadline or none)
        or (old.until is not None and new.until != old.until)
        or (new.stop_after or none) > (old.stop_after or none)
    )


def _request(
    state: LabState,
    subject: str,
    kind: str,
    name: str,
    asked: Submission,
    actor: str,
    why: tuple[Why, ...],
    parts: dict[str, str],
    also: list[int],
    terms: Terms | None = None,
) -> ApprovalRequested | None:
    """The event that has a submission wait; None if nothing says that it has to."""
    if not why:
        return None
    past = state.approvals.last("campaign" if kind == "amendment" else kind, name)  # type: ignore[arg-type]
    was = past.parts if past is not None else {}
    changed = sorted(
        part for part in {*parts, *was} if parts.get(part) != was.get(part) and part not in UNCOMPARED
    )
    return ApprovalRequested(
        subject=subject,
        kind=kind,  # type: ignore[arg-type]
        name=name,
        user=asked.user,
        by=actor,
        digest=digest(canonical([subject, kind, name, asked.user, parts, also])),
        why=why,
        parts=parts,
        demand=asked.demand,
        before=past.subject if past is not None else "",
        changed=tuple(changed) if past is not None else (),
        terms=terms,
    )


UNCOMPARED = ("plan", "experiment")
"""Parts that follow from others, or are others each time."""


def _digest_of(values: Terms | dict[str, Any]) -> str:
    try:
        return digest(canonical(values))
    except (ValueError, TypeError, OverflowError, RecursionError):
        return ""  # it cannot be recorded, and is refused for that


# -- the answer ----------------------------------------------------------------------------------


@decides(ApproveProposal)
def approve_proposal(state: LabState, command: ApproveProposal) -> Decision:
    proposal = _open(state, command.subject)
    if isinstance(proposal, Rejection):
        return proposal
    wrong = _not_as_seen(proposal, command.digest) or _unfit_changes(state, proposal, command)
    if wrong is not None:
        return wrong
    events = approving(state, proposal, command)
    if isinstance(events, Rejection):
        return events
    return chain(_answered(state, proposal.subject, "approve", command.by, command.why), events)


@decides(RefuseProposal)
def refuse_proposal(state: LabState, command: RefuseProposal) -> Decision:
    proposal = _open(state, command.subject)
    if isinstance(proposal, Rejection):
        return proposal
    return chain(
        _answered(state, proposal.subject, "refuse", command.by, command.why),
        refusing(state, proposal, command),
    )


def answer_question(state: LabState, topic: Approval, choice: str, by: str, note: str) -> Decision:
    """The same, as the answer to the question about a proposal."""
    proposal = _open(state, topic.about)
    if isinstance(proposal, Rejection):
        return []
    if choice != "approve":
        return refusing(state, proposal, RefuseProposal(topic.about, by, note))
    wrong = _not_as_seen(proposal, topic.digest)
    return wrong or approving(state, proposal, ApproveProposal(topic.about, topic.digest, by, note))


def approving(state: LabState, proposal: Proposal, command: ApproveProposal) -> Decision:
    wrong = _may_not_approve(state, proposal, command.by) or _experiment_first(state, proposal)
    return wrong or _approving(state, proposal, command)


def _approving(state: LabState, proposal: Proposal, command: ApproveProposal) -> Iterator[Event]:
    yield ApprovalGiven(
        subject=proposal.subject,
        kind=proposal.kind,
        digest=proposal.digest,
        by=command.by,
        comment=command.why,
        priority=command.priority,
        terms=command.terms,
        alike=command.alike,
    )
    if proposal.kind == "amendment" and proposal.terms is not None:
        yield CampaignAmended(CampaignId(proposal.subject), command.terms or proposal.terms)
    run = state.runs.queued.get(RunId(proposal.subject))
    if run is not None and run.unapproved and person_of(command.by) != run.user:
        yield RunApproved(run.id, command.by)
    if proposal.kind == "experiment":
        for waiting in list(_waiting_for(state, proposal.subject)):
            yield from _answered(state, waiting.subject, "approve", command.by, command.why)
            yield ApprovalGiven(waiting.subject, "run", waiting.digest, command.by, command.why)


def refusing(state: LabState, proposal: Proposal, command: RefuseProposal) -> Iterator[Event]:
    subject, kind = proposal.subject, proposal.kind
    said = f": {command.why}" if command.why else ""
    why = f"{command.by} did not approve it{said}"
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
    yield from [] if isinstance(follows, Rejection) else follows


def _waiting_for(state: LabState, experiment: str) -> Iterator[Proposal]:
    """The runs of an experiment that wait for nothing but its approval."""
    known = state.experiments.open[ExperimentId(experiment)]
    for run in known.runs:
        proposal = state.approvals.open.get(run)
        if proposal is not None and proposal.codes == {"experiment"}:
            yield proposal


def _open(state: LabState, subject: str) -> Proposal | Rejection:
    found = state.approvals.open.get(subject)
    return found or Rejection(
        "no_proposal",
        f"{subject} does not wait for an approval.",
        "List what does: labos approvals",
    )


def _not_as_seen(proposal: Proposal, seen: str) -> Rejection | None:
    """Why an answer is not about the proposal as it is now."""
    if len(seen) >= SHORTEST_DIGEST and proposal.digest.startswith(seen):
        return None
    return Rejection(
        "changed",
        f"{proposal.subject} is not what was looked at: its digest is {proposal.digest[:SHORTEST_DIGEST]}.",
        f"Look at it again: labos approvals {proposal.subject}",
    )


def _unfit_changes(state: LabState, proposal: Proposal, command: ApproveProposal) -> Rejection | None:
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
            "Runs and experiments have a priority, campaigns have terms, and only a run of an experiment has "
            "others alike.",
        )
    if command.terms is None:
        return None
    return unfit_terms(state.campaigns.open[CampaignId(proposal.subject)], command.terms)


def _may_not_approve(state: LabState, proposal: Proposal, by: str) -> Rejection | None:
    user = state.users.known.get(by)
    if ON_BEHALF in by or (user is not None and user.kind == "service"):
        return Rejection("no_person", f"{by} is no person.", "Ask an operator to look at it.")
    own = by in (proposal.user, person_of(proposal.by))
    if own and not state.approvals.policy.own:
        return Rejection(
            "own_approval",
            f"{proposal.subject} is {by}'s own, and the lab's policy wants somebody else to approve it.",
            "Ask another operator; or an admin allows it: `own: true` in the file of labos policy --apply",
        )
    return None


def _experiment_first(state: LabState, proposal: Proposal) -> Rejection | None:
    """Why a run cannot be approved before its experiment is."""
    experiment = proposal.parts.get("experiment", "") if proposal.kind == "run" else ""
    known: Experiment | None = state.experiments.open.get(ExperimentId(experiment))
    if known is None or not known.held:
        return None
    return Rejection(
        "experiment_first",
        f"The experiment {known.id} of {proposal.subject} waits for an approval itself.",
        f"Approve that first: labos approve {known.id}",
    )


# -- the question --------------------------------------------------------------------------------


def _questions(state: LabState, subject: str) -> list[Intervention]:
    return [q for q in state.interventions.all_about(subject) if isinstance(q.topic, Approval)]


def _answered(
    state: LabState, subject: str, choice: str, by: str, note: str
) -> Iterable[InterventionResolved]:
    """The question about a proposal is answered along with it."""
    return [InterventionResolved(q.id, choice, by, note) for q in _questions(state, subject)]


# -- reactions -----------------------------------------------------------------------------------


def ask_for_approval(state: LabState, event: ApprovalRequested) -> Iterator[Event]:
    """An operator is asked, and an earlier question about the same is withdrawn."""
    for question in _questions(state, event.subject):
        yield InterventionResolved(question.id, "withdrawn", "labos", "it was changed, and is asked anew")
    what = {"amendment": "The change of campaign"}.get(event.kind, event.kind.capitalize())
    why = "; ".join(why.text for why in event.why)
    text = (
        f"{what} {event.subject} ({event.name}) of {event.user} waits for approval, because {why}. "
        f"Look at it: labos approvals {event.subject}"
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
    """Nobody is asked any more about what has ended."""
    subject = event.campaign if hasattr(event, "campaign") else event.experiment
    for question in _questions(state, subject):
        yield InterventionResolved(question.id, "withdrawn", "labos", "it has ended")


__all__ = [
    "ApplyPolicy",
    "ApproveProposal",
    "RefuseProposal",
    "answer_question",
    "ask_for_approval",
    "considered",
    "more_than",
    "withdraw_approval_question",
]
