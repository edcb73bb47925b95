"""The lab's policy applied to a submission: whether it waits for an approval, and its priority."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import msgspec

from labos.core.approvals import Demand, Why, take_common_parts
from labos.core.campaigns import Budget, Terms
from labos.core.decide._base import Command, Rejection
from labos.core.decide.campaigns import AmendCampaign, SubmitCampaign, compute_module_time_s
from labos.core.decide.experiments import StartExperiment
from labos.core.decide.runs import SubmitRun
from labos.core.ids import ExperimentId, local
from labos.core.model import MAIN, Plan
from labos.core.quotas import find_highest_priority
from labos.core.resources import sum_consumption
from labos.core.roles import rank_role_in
from labos.core.state import LabState
from labos.core.users import LABOS, ON_BEHALF, find_person, rank

COVERED = ("program", "newcomer")
"""Reasons that do not apply to runs like one that was approved with `alike`."""

MOST_DANGERS = 20
"""At most this number of dangerous steps is named."""


class Submission(msgspec.Struct, frozen=True):
    """The properties of a submission that the policy depends on. ``terms`` are those of a campaign;
    ``before`` are its present terms if they are being changed."""

    user: str
    workcell: str
    demand: Demand
    propose: bool = False
    terms: Terms | None = None
    before: Terms | None = None


def sum_demand(plans: Iterable[Plan], times: float = 1.0) -> Demand:
    """The work and material that plans need, multiplied by ``times``."""
    steps, time, modules = 0, 0.0, dict[str, float]()
    consumables, dangers = dict[str, float](), dict[str, bool]()
    for plan in plans:
        steps += sum(step.part == MAIN for step in plan.steps)
        time += compute_module_time_s(plan)
        for step in plan.steps:
            if step.part == MAIN:
                name = local(step.module)
                modules[name] = modules.get(name, 0.0) + step.duration_s * times
        for kind, amount in sum_consumption(plan).items():
            consumables[kind] = consumables.get(kind, 0.0) + amount * times
        dangers.update(dict.fromkeys(list_dangers(plan), True))
    named = tuple(dangers)[:MOST_DANGERS]
    return Demand(round(steps * times), time * times, modules, consumables, named)


def sum_demand_of_choices(plans: Sequence[Plan]) -> Demand:
    """The work and material of a run that may follow one of these plans: those of the longest plan, with the
    dangerous steps of all plans."""
    demands = [sum_demand([plan]) for plan in plans]
    dangers = dict.fromkeys(danger for demand in demands for danger in demand.dangers)
    most = max(demands, key=lambda demand: demand.module_time_s)
    return msgspec.structs.replace(most, dangers=tuple(dangers)[:MOST_DANGERS])


def list_dangers(plan: Plan) -> tuple[str, ...]:
    """The dangerous steps of a plan, as text."""
    found = [f"{step.key} on {local(step.module)} ({step.hazard})" for step in plan.steps if step.hazard]
    return tuple(found[:MOST_DANGERS])


# -- priority ------------------------------------------------------------------------------------


def refuse_priority(state: LabState, command: Any, actor: str) -> Rejection | None:
    """Why a submission may not have the requested priority; None if it may."""
    if isinstance(command, SubmitCampaign | AmendCampaign):
        priority = command.terms.priority
    else:
        priority = command.priority
    if (
        isinstance(command, AmendCampaign)
        and priority <= state.campaigns.open[command.campaign].terms.priority
    ):
        return None
    who = find_person(actor) if actor != LABOS else getattr(command, "user", "")
    operates = not state.users.is_open and rank_role_in(state, who, _find_cell(state, command)) >= rank(
        "operator"
    )
    found = find_highest_priority(state, who, operates=operates)
    if found is None or priority <= found[1]:
        return None
    whose, most = found
    return Rejection(
        "priority",
        f"The priority {priority} is above {most}, which is the highest for {whose}.",
        f"Give {most} or less, or ask an operator to raise it: labos approve and labos campaign amend can.",
    )


def _find_cell(state: LabState, command: Command) -> str:
    match command:
        case SubmitRun():
            return command.plan.workcell
        case SubmitCampaign():
            return command.workcell
        case AmendCampaign():
            return state.campaigns.open[command.campaign].workcell
        case StartExperiment():
            return command.closing.workcell if command.closing is not None else ""
        case _:
            pass
    return ""


# -- approval ------------------------------------------------------------------------------------


def list_approval_reasons(
    state: LabState, asked: Submission, actor: str, experiment: str = ""
) -> tuple[Why, ...]:
    """Why a submission of ``actor``, to an experiment or to none, waits for an approval; empty if it does
    not. ``leave_out_covered`` leaves out the reasons that do not apply to runs like an approved one."""
    found = tuple(_iterate_reasons(state, asked, actor))
    if _is_held(state, experiment):
        found = (*found, Why("experiment", f"its experiment {experiment} waits for an approval"))
    return found


def may_need_approval(state: LabState, actor: str, experiment: str, *, propose: bool) -> bool:
    """Whether a submission of ``actor`` may need an approval. If not, its content makes no difference."""
    return (
        propose
        or state.approvals.policy.depends_on_content
        or bool(find_service(state, actor))
        or _is_held(state, experiment)
    )


def _is_held(state: LabState, experiment: str) -> bool:
    known = state.experiments.open.get(ExperimentId(experiment)) if experiment else None
    return known is not None and known.held


def leave_out_covered(state: LabState, why: tuple[Why, ...], parts: dict[str, str]) -> tuple[Why, ...]:
    """These reasons without those that do not apply, if a run like the one with these ``parts`` was approved
    with `alike`."""
    alike = state.approvals.alike.get(parts.get("experiment", ""), {})
    if alike and take_common_parts(parts) in alike:
        return tuple(reason for reason in why if reason.code not in COVERED)
    return why


def _iterate_reasons(state: LabState, asked: Submission, actor: str) -> Iterator[Why]:
    policy, person = state.approvals.policy, find_person(actor)
    if asked.propose:
        yield Why("asked", f"{actor} requests it")
    if actor == LABOS or "/" in actor:
        return
    service = find_service(state, actor)
    if service and policy.programs and service not in policy.trusted:
        yield Why("program", f"it was made by a program ({service})")
    operates = (
        not state.users.is_open
        and not service
        and rank_role_in(state, person, asked.workcell) >= rank("operator")
    )
    others = asked.before is not None and person != asked.user
    if operates and (policy.own or others):
        return  # the submitter could approve it anyway
    given = state.approvals.given.get(asked.user, 0)
    is_vouched_for = operates or asked.user in policy.trusted or state.users.is_open
    if given < policy.newcomers and not is_vouched_for:
        count = f"{given} of the first {policy.newcomers} submissions have been approved"
        yield Why("newcomer", f"{asked.user} is new here: {count}")
    if policy.dangerous and asked.demand.dangers:
        yield Why("dangerous", f"it has dangerous steps: {', '.join(asked.demand.dangers)}")
    beyond = _describe_excess(policy.above, asked)
    if beyond:
        yield Why("budget", beyond)
    sooner = asked.terms is not None and _is_sooner(asked.terms, asked.before)
    if policy.deadlines and sooner and not operates:
        yield Why("deadline", "it has a deadline, so other work may have to wait")


def find_service(state: LabState, actor: str) -> str:
    """The service account that acts, for itself or for a person; empty if there is none."""
    name, _, person = actor.rpartition(ON_BEHALF)
    user = state.users.known.get(name or person)
    return name or person if user is not None and user.kind == "service" else ""


def _is_sooner(terms: Terms, before: Terms | None) -> bool:
    was = before.deadline if before is not None else 0
    return bool(terms.deadline) and (not was or terms.deadline < was)


def _describe_excess(most: Budget, asked: Submission) -> str:
    """The parts of a submission that exceed the limit and need an approval, as text. For a campaign, the
    smaller one counts: its budget, or what its rows need by their plans."""
    need, budget = asked.demand, asked.terms.budget if asked.terms is not None else Budget()
    was = asked.before.budget if asked.before is not None else None
    rows = min(need.rows, budget.runs or need.rows)
    if most.runs and rows > most.runs and (was is None or rows > (was.runs or need.rows)):
        return f"it has {rows} runs, and more than {most.runs} need an approval"
    time = _may_use(budget.lab_time_s or None, need.module_time_s, known=was is None)
    if most.lab_time_s and time > most.lab_time_s and (was is None or time > (was.lab_time_s or time)):
        return (
            f"it may take {_hours(time)} lab time, and more than {_hours(most.lab_time_s)} need an approval"
        )
    for kind, limit in most.consumables.items():
        planned = need.consumables.get(kind, 0.0)
        amount = _may_use(budget.consumables.get(kind), planned, known=was is None)
        if amount > limit and (was is None or amount > was.consumables.get(kind, amount)):
            return f"it may use {_amount(amount)} {kind}, and more than {limit:g} need an approval"
    return ""


def _may_use(limit: float | None, planned: float, *, known: bool) -> float:
    """The most that may be used: the planned amount, or the limit if that is smaller; infinite without
    both."""
    most = float("inf") if limit is None else limit
    return min(planned, most) if known else most


def _hours(seconds: float) -> str:
    return "any" if seconds == float("inf") else f"{seconds / 3600:.3g} h"


def _amount(amount: float) -> str:
    return "any number of" if amount == float("inf") else f"{amount:g}"
