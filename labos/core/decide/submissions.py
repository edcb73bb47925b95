"""The entry of all submissions: each is checked here after it was decided, and waits for an approval if it
needs one.

This does not depend on who submits it, or through which interface. The effects of a plan on the bench are not
checked here: an approved run is scheduled like any other.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from typing import Any

import msgspec

from labos.core.approvals import ApprovalRequested, Demand, Kind, Why
from labos.core.campaigns import Campaign, Terms
from labos.core.canonical import digest, encode_canonical
from labos.core.decide._base import Command, Decision, Rejection, check_recordable, decides
from labos.core.decide.campaigns import (
    AmendCampaign,
    RefuseRow,
    SubmitCampaign,
    SubmitRow,
    SubmitRows,
    refuse_row,
    submit_row,
)
from labos.core.decide.composites import SubmitRuns, SubmitWithLabware, list_new, name_run
from labos.core.decide.experiments import StartExperiment
from labos.core.decide.policy import (
    Submission,
    find_service,
    leave_out_covered,
    list_approval_reasons,
    may_need_approval,
    refuse_priority,
    sum_demand,
    sum_demand_of_choices,
)
from labos.core.decide.runs import SubmitRun, submit_run
from labos.core.experiments import ExperimentStarted
from labos.core.policy import Policy, PolicyApplied
from labos.core.registry import Event
from labos.core.runs import RunSubmitted
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.users import LABOS, ON_BEHALF, find_person


class ApplyPolicy(Command, frozen=True):
    """Apply the policy from the file with this ``digest``."""

    digest: str
    policy: Policy


@decides(ApplyPolicy)
def apply_policy(state: LabState, command: ApplyPolicy) -> Decision:
    if (state.approvals.applied, state.approvals.policy) == (command.digest, command.policy):
        return []
    return [PolicyApplied(command.digest, command.policy)]


@decides(SubmitRows)
def submit_rows(state: LabState, command: SubmitRows) -> Decision:
    """The first row is decided as if it were alone; then as many further rows as are allowed."""
    first = _decide_next_row(state, command.rows[0]) if command.rows else []
    return first if isinstance(first, Rejection) else _submit_rows(state, command.rows)


def _submit_rows(state: LabState, rows: tuple[SubmitRow | RefuseRow, ...]) -> Iterator[Event]:
    for row in rows:
        decision = _decide_next_row(state, row)
        if isinstance(decision, Rejection):
            return
        yield from decision


def _decide_next_row(state: LabState, row: SubmitRow | RefuseRow) -> Decision:
    decision = submit_row(state, row) if isinstance(row, SubmitRow) else refuse_row(state, row)
    return check_recordable(hold_for_approval(state, row, decision, LABOS))


def name_both_actors(command: Command, actor: str) -> Command:
    """The command as it is recorded. If a service account submits for a person, both names are recorded, so
    that it does not look like the person's own request."""
    if ON_BEHALF not in actor:
        return command
    changed: dict[str, Any] = {}
    for name in command.__struct_fields__:
        value = getattr(command, name)
        if name == "by" and value == find_person(actor):
            changed[name] = actor
        elif isinstance(value, Command):
            changed[name] = name_both_actors(value, actor)
        elif isinstance(value, tuple) and any(isinstance(part, Command) for part in value):
            changed[name] = tuple(name_both_actors(part, actor) for part in value)
    return msgspec.structs.replace(command, **changed) if changed else command


def hold_for_approval(state: LabState, command: Command, decision: Decision, actor: str) -> Decision:
    """The events of a submission of ``actor``, with the request for an approval if it needs one."""
    if not isinstance(command, _SUBMISSIONS) or isinstance(decision, Rejection):
        return decision
    if isinstance(command, SubmitWithLabware):
        return _with_labware(state, command, decision, actor)
    if isinstance(command, SubmitRuns):
        return _each_of_batch(state, command, decision, actor)
    if isinstance(command, ApplyPolicy):
        return _check_policy_actor(state, actor) or decision
    events = list(decision)
    if not events:
        return events  # it is known already
    if isinstance(command, SubmitRow):
        return _decide_row(state, command, events)
    if high := refuse_priority(state, command, actor):
        return high
    match command:
        case SubmitRun():
            request = _request_for_run(state, command, events, actor)
        case SubmitCampaign():
            request = _request_for_campaign(state, command, actor)
        case StartExperiment():
            request = _request_for_experiment(state, command, events, actor)
        case AmendCampaign():
            return _decide_amendment(state, command, events, actor)
    return [*events, *request]


_SUBMISSIONS = (
    ApplyPolicy,
    SubmitRun,
    SubmitWithLabware,
    SubmitRuns,
    SubmitCampaign,
    StartExperiment,
    AmendCampaign,
    SubmitRow,
)


def _with_labware(
    state: LabState, command: SubmitWithLabware, decision: Iterable[Event], actor: str
) -> Decision:
    """A run that is submitted with labware waits like any other run. The labware is recorded in any case."""
    known = submit_run(state, command.run)
    run = hold_for_approval(state, command.run, known, actor)
    if isinstance(run, Rejection):
        return run
    return chain(decision, [event for event in run if isinstance(event, ApprovalRequested)])


def _each_of_batch(state: LabState, command: SubmitRuns, decision: Iterable[Event], actor: str) -> Decision:
    """Each of several runs waits like any other run."""
    new = list_new(state, command)
    for number, run in new.items():
        high = refuse_priority(state, run, actor)
        if high is not None:
            return name_run(command, number, high)
    return _hold_each(state, list(new.values()), decision, actor)


def _hold_each(
    state: LabState, runs: list[SubmitRun], decision: Iterable[Event], actor: str
) -> Iterator[Event]:
    """Each event is folded before the next one is computed."""
    left = iter(runs)
    for event in decision:
        yield event
        if isinstance(event, RunSubmitted):
            yield from _request_for_run(state, next(left), [event], actor)


def _check_policy_actor(state: LabState, actor: str) -> Rejection | None:
    """Why the policy may not be changed: a program must not approve its own submissions."""
    service = find_service(state, actor)
    if not service:
        return None
    return Rejection(
        "no_person",
        f"{service} is a program, and programs may not change the policy.",
        "Ask an admin to do it.",
    )


def _request_for_run(state: LabState, command: SubmitRun, events: list[Event], actor: str) -> list[Event]:
    event = next(event for event in events if isinstance(event, RunSubmitted))
    if not may_need_approval(state, actor, event.experiment, propose=command.propose):
        return []
    demand = sum_demand_of_choices(command.plans)
    asked = Submission(event.user, command.plan.workcell, demand, command.propose)
    why = list_approval_reasons(state, asked, actor, event.experiment)
    if not why:
        return []
    pins = {name: value for name, value in event.pins.items() if name != "request"}
    parts = {
        **pins,
        **{f"file:{name}": value for plan in command.plans for name, value in plan.files.items()},
        "plan": event.plan,
        **({"choices": digest(encode_canonical(list(event.choices)))} if event.choices else {}),
        "payload": _make_digest(event.payload),
        **({"experiment": event.experiment} if event.experiment else {}),
    }
    also = [event.priority]
    return _request(state, event.run, "run", event.workflow, asked, actor, parts, also, why=why)


def _request_for_campaign(state: LabState, command: SubmitCampaign, actor: str) -> list[Event]:
    name = f"C{state.campaigns.named + 1}"
    demand = msgspec.structs.replace(command.demand, rows=command.rows)
    asked = Submission(command.user, command.workcell, demand, command.propose, command.terms)
    parts = _list_table_parts(command, command.terms)
    return _request(state, name, "campaign", command.name, asked, actor, parts)


def _list_table_parts(of: SubmitCampaign | Campaign, terms: Terms) -> dict[str, str]:
    return {"workflow": of.definition, "table": of.table, "terms": _make_digest(terms)}


def _request_for_experiment(
    state: LabState, command: StartExperiment, events: list[Event], actor: str
) -> list[Event]:
    event = next(event for event in events if isinstance(event, ExperimentStarted))
    plan = command.closing
    demand = sum_demand([plan] if plan is not None else [])
    asked = Submission(command.user, plan.workcell if plan is not None else "", demand, command.propose)
    parts = {"closing": event.closing, "parking": digest(encode_canonical(list(event.parking)))}
    also = [event.priority]
    return _request(state, event.experiment, "experiment", event.name, asked, actor, parts, also)


def _decide_amendment(state: LabState, command: AmendCampaign, events: list[Event], actor: str) -> Decision:
    """The new terms of a campaign that waits for an approval need an approval again. If the campaign is under
    way, a change that allows it more waits, and the campaign continues under its old terms."""
    campaign = state.campaigns.open[command.campaign]
    waiting = state.approvals.open.get(campaign.id)
    who, name = (campaign.user, campaign.workcell), campaign.name
    if waiting is not None and waiting.kind == "campaign":
        parts = {**waiting.parts, "terms": _make_digest(command.terms)}
        asked = Submission(*who, waiting.demand, terms=command.terms)
        again = _request(state, campaign.id, "campaign", name, asked, waiting.by, parts, why=waiting.why)
        return [*events, *again]
    if not allows_more(campaign.terms, command.terms):
        return events
    asked = Submission(*who, Demand(rows=campaign.rows), False, command.terms, campaign.terms)
    parts = _list_table_parts(campaign, command.terms)
    return _request(state, campaign.id, "amendment", name, asked, actor, parts) or events


def _decide_row(state: LabState, command: SubmitRow, events: list[Event]) -> list[Event]:
    """A campaign waits for an approval before a row with a dangerous step, if the danger was not known when
    the campaign was submitted or approved."""
    campaign = state.campaigns.open[command.campaign]
    dangers = sum_demand_of_choices((command.plan, *command.others)).dangers
    if not dangers or campaign.danger_seen or not any(isinstance(e, RunSubmitted) for e in events):
        return events
    demand = Demand(dangers=dangers, rows=campaign.rows)
    asked = Submission(campaign.user, campaign.workcell, demand, False, campaign.terms)
    parts = _list_table_parts(campaign, campaign.terms)
    reasons = list_approval_reasons(state, asked, campaign.user)
    why = tuple(reason for reason in reasons if reason.code == "dangerous")
    who, name = campaign.user, campaign.name
    return _request(state, campaign.id, "campaign", name, asked, who, parts, why=why) or events


def allows_more(old: Terms, new: Terms) -> bool:
    """Whether a campaign may do more, or start earlier, under new terms than under the old ones."""
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
    kind: Kind,
    name: str,
    asked: Submission,
    actor: str,
    parts: dict[str, str],
    also: Sequence[int] = (),
    why: tuple[Why, ...] | None = None,
) -> list[Event]:
    """The event that makes a submission wait for an approval; none if it needs none. ``why`` are the reasons
    if they are known already."""
    why = leave_out_covered(state, list_approval_reasons(state, asked, actor) if why is None else why, parts)
    if not why:
        return []
    past = state.approvals.find_last("campaign" if kind == "amendment" else kind, name)
    was = past.parts if past is not None else {}
    changed = sorted(
        part for part in {*parts, *was} if parts.get(part) != was.get(part) and part not in UNCOMPARED
    )
    request = make_from(
        ApprovalRequested,
        asked,
        subject=subject,
        kind=kind,
        name=name,
        by=actor,
        digest=digest(encode_canonical([subject, kind, name, asked.user, parts, also])),
        why=why,
        parts=parts,
        before=past.subject if past is not None else "",
        changed=tuple(changed) if past is not None else (),
    )
    return [request]


UNCOMPARED = ("plan", "choices", "experiment")
"""Parts that follow from other parts, or that are different each time."""


def _make_digest(values: Terms | dict[str, Any]) -> str:
    try:
        return digest(encode_canonical(values))
    except (ValueError, TypeError, OverflowError, RecursionError):
        return ""  # it cannot be recorded, and is refused for that reason
