"""Campaigns whose deadline is near: their runs go before other runs of any priority."""

from __future__ import annotations

from labos.core.campaigns import Campaign
from labos.core.decide.campaigns import compute_module_time_s
from labos.core.rules import convert_lab_s
from labos.core.runs import RunState
from labos.core.state import LabState

MARGIN = 2.0
"""A campaign is urgent once its deadline is at most this many times its expected remaining duration away."""


def is_urgent(state: LabState, run: RunState, now: int) -> bool:
    """Whether a run belongs to a campaign that may miss its deadline."""
    campaign = state.campaigns.open.get(run.campaign) if run.campaign else None
    return campaign is not None and find_urgent_from(state, campaign, run) <= now


def find_urgent_from(state: LabState, campaign: Campaign, run: RunState) -> float:
    """The time from which a campaign is urgent (UTC ns); infinite without a deadline. Its remaining duration
    is estimated from the time that each ended row took on average since the first start. If no row has ended,
    the module time of the run's plan counts for each row."""
    if not campaign.terms.deadline:
        return float("inf")
    ended = campaign.completed + campaign.failed
    if ended and campaign.first_started_at:
        row_ns = (state.recorded_at - campaign.first_started_at) / ended
    else:
        row_ns = float(convert_lab_s(state, compute_module_time_s(state.runs.plan_of(run))))
    return campaign.terms.deadline - MARGIN * row_ns * (campaign.left + len(campaign.runs))
