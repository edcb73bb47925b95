"""Whether a user's quotas leave room for another run, waiting or under way."""

from __future__ import annotations

from collections.abc import Collection

from labos.core import reasons
from labos.core.model import MAIN, PlanStep
from labos.core.resources import list_used_up, sum_consumption
from labos.core.runs import RunState, RunStatus, StepStatus
from labos.core.shares import DAY_NS
from labos.core.state import LabState
from labos.core.waits import Wait

QUOTA_KEY = "quota"
"""The key that is touched when a run has ended or quotas have changed."""


def explain_full_queue(state: LabState, user: str, ahead: int = 0) -> str:
    """Why a user may not have one more run waiting, as a sentence; empty if they may. ``ahead`` is the number
    of runs that are submitted with it, before it."""
    for whose, quota, had in state.shares.list_limits(user):
        waiting = had.queued + ahead
        if quota.queued and waiting >= quota.queued:
            return f"{waiting} runs of {whose} already wait; at most {quota.queued} may wait."
    return ""


def find_highest_priority(state: LabState, user: str, *, operates: bool) -> tuple[str, int] | None:
    """The source of the limit, and the highest priority that a user may give. It comes from quotas;
    otherwise, for a user who is not an operator, from the lab's policy. None: no limit."""
    named = [(whose, q.priority) for whose, q, _ in state.shares.list_limits(user) if q.priority is not None]
    if named:
        return min(named, key=lambda item: item[1])
    most = state.approvals.policy.priority
    return None if most is None or operates else ("whoever has no quota for it", most)


def check_quota(state: LabState, run: RunState, now: int) -> Wait | None:
    """A waiting run is admitted only if the quotas of its user and group leave room for it. Other users' runs
    do not wait for it. Runs under way count by their plans. Closing runs, which clear labware away, are
    always admitted."""
    if run.has_started or run.closing or not (state.shares.members or state.shares.groups):
        return None
    tomorrow = (now // DAY_NS + 1) * DAY_NS
    for whose, quota, had in state.shares.list_limits(run.user):
        if quota.running and had.running >= quota.running:
            return Wait(reasons.Quota(whose, f"{quota.running} runs at a time"), (QUOTA_KEY,))
        if not (quota.lab_hours or quota.consumables):
            continue
        seconds, amounts = _sum_in_progress(state, _list_users(state, whose, run.user), now)
        hours = had.week.sum_lab_ns(now) * state.lab.pace / 3.6e12 + seconds / 3600
        if quota.lab_hours and hours >= quota.lab_hours:
            what = f"{quota.lab_hours:g} lab hours a week"
            return Wait(reasons.Quota(whose, what), (QUOTA_KEY,), tomorrow)
        for kind, most in quota.consumables.items():
            needed = sum_consumption(state.runs.plan_of(run)).get(kind, 0.0)
            if needed and had.week.count_used(kind, now) + amounts.get(kind, 0.0) + needed > most:
                return Wait(reasons.Quota(whose, f"{most:g} {kind} a week"), (QUOTA_KEY,), tomorrow)
    return None


def _list_users(state: LabState, whose: str, user: str) -> Collection[str]:
    """The users who share a quota."""
    group = state.shares.groups.get(state.shares.group_of.get(user, ""))
    return (user,) if whose == user or group is None else group.members


def _sum_in_progress(state: LabState, users: Collection[str], now: int) -> tuple[float, dict[str, float]]:
    """The lab seconds, and the consumables by kind, that started runs still need. A step under way counts
    with its planned duration, or with its real duration so far if that is longer."""
    seconds, amounts = 0.0, dict[str, float]()
    lasted = {
        (action.run, action.step): (now - action.requested_at) * state.lab.pace / 1e9
        for action in state.actions.open.values()
    }
    for name in state.shares.started:
        run = state.runs.active.get(name)
        if run is None or run.user not in users:
            continue
        steps = state.runs.plan_of(run).steps
        left = {index for index, step in enumerate(steps) if _is_to_come(run, index, step)}
        seconds += sum(max(steps[index].duration_s, lasted.get((name, index), 0.0)) for index in left)
        for index, _, kind, amount in list_used_up(steps):
            if index in left:
                amounts[kind] = amounts.get(kind, 0.0) + amount
    return seconds, amounts


def _is_to_come(run: RunState, index: int, step: PlanStep) -> bool:
    """Whether a step is under way, or will be carried out if no step fails."""
    status = run.steps[index].status
    if status in (StepStatus.IN_FLIGHT, StepStatus.UNKNOWN):
        return True
    if status != StepStatus.PENDING or run.status == RunStatus.CANCELLING:
        return False
    return step.part == MAIN or run.status == RunStatus.LEAVING
