"""Whether a user's quotas leave room for another run, waiting or under way."""

from __future__ import annotations

from labos.core import reasons
from labos.core.model import MAIN
from labos.core.resources import uses_up
from labos.core.runs import RunState
from labos.core.shares import DAY_NS
from labos.core.state import LabState
from labos.core.waits import Wait

QUOTA_KEY = "quota"
"""Touched when a run has ended, or quotas are others."""


def queue_is_full(state: LabState, user: str) -> str:
    """Why a user may have no further run wait, as a sentence; empty if one may."""
    for whose, quota, had in state.shares.limits(user):
        if quota.queued and had.queued >= quota.queued:
            return f"{had.queued} runs of {whose} wait already, and {quota.queued} may."
    return ""


def highest_priority(state: LabState, user: str, *, operates: bool) -> tuple[str, int] | None:
    """Whose limit it is, and the highest priority that a user may give: by quotas, else, for somebody who is
    no operator, by the lab's policy. None: any."""
    named = [(whose, q.priority) for whose, q, _ in state.shares.limits(user) if q.priority is not None]
    if named:
        return min(named, key=lambda item: item[1])
    most = state.approvals.policy.priority
    return None if most is None or operates else ("whoever has no quota for it", most)


def within_quota(state: LabState, run: RunState, now: int) -> Wait | None:
    """A run that waits is let in only if its user's quotas, and those of the group, leave room for it; nobody
    waits with it meanwhile. What clears a bench away is never kept out."""
    if run.has_started or run.closing or not (state.shares.members or state.shares.groups):
        return None
    tomorrow = (now // DAY_NS + 1) * DAY_NS
    for whose, quota, had in state.shares.limits(run.user):
        if quota.running and had.running >= quota.running:
            return Wait(reasons.Quota(whose, f"{quota.running} runs at a time"), (QUOTA_KEY,))
        hours = had.week.lab_ns(now) * state.lab.pace / 3.6e12
        if quota.lab_hours and hours >= quota.lab_hours:
            what = f"{quota.lab_hours:g} lab hours a week"
            return Wait(reasons.Quota(whose, what), (QUOTA_KEY,), tomorrow)
        for kind, most in quota.consumables.items():
            needed = sum(
                amount
                for index, _, resource, amount in uses_up(state.runs.plan_of(run).steps)
                if resource == kind and state.runs.plan_of(run).steps[index].part == MAIN
            )
            if needed and had.week.of(kind, now) + needed > most:
                return Wait(reasons.Quota(whose, f"{most:g} {kind} a week"), (QUOTA_KEY,), tomorrow)
    return None
