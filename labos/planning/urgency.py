"""Campaigns whose deadline is near: their runs go before others of any priority."""

from __future__ import annotations

from labos.core.campaigns import Campaign
from labos.core.decide.campaigns import compute_module_time_s
from labos.core.rules import convert_lab_s
from labos.core.runs import RunState
from labos.core.state import LabState

MARGIN = 2.0
"""A campaign is urgent once it has less than so many times the time left that it still needs."""


def is_urgent(state: LabState, run: RunState, now: int) -> bool:
    """Whether a run belongs to a campaign that may miss its deadline."""
    campaign = state.campaigns.open.get(run.campaign) if run.campaign else None
    return campaign is not None and find_urgent_from(state, campaign, run) <= now


def find_urgent_from(state: LabState, campaign: Campaign, run: RunState) -> float:
    """When a campaign becomes urgent, or has (UTC ns): before it is late, by what its rows have taken so far,
    one with another, or what a run of it takes by its plan. Never, without a deadline."""
    if not campaign.terms.deadline:
        return float("inf")
    ended = campaign.completed + campaign.failed
    if ended and campaign.first_started_at:
        row_ns = (state.recorded_at - campaign.first_started_at) / ended
    else:
        row_ns = float(convert_lab_s(state, compute_module_time_s(state.runs.plan_of(run))))
    return campaign.terms.deadline - MARGIN * row_ns * (campaign.left + len(campaign.runs))
