"""Campaigns as the log shows them: all of them, or one row by row."""

from __future__ import annotations

from typing import Any

import msgspec

from labos.core import campaigns
from labos.core.campaigns import (
    Campaign,
    CampaignArchived,
    CampaignCompleted,
    CampaignEvent,
    CampaignRowRefused,
    Campaigns,
    CampaignSubmitted,
    CampaignUnarchived,
)
from labos.core.registry import list_handlers
from labos.core.runs import RunSubmitted
from labos.core.viewer import Visibility
from labos.errors import NotFound
from labos.ports import LogQuery
from labos.services.catalogue import read_catalogue
from labos.services.log import Log, decode_events
from labos.services.runs import FAMILIES, RunBook

TYPES = ("campaign", *FAMILIES, "step", "resource")


class CampaignHistory(msgspec.Struct):
    """A campaign, the users who may see it, when it ended (UTC ns, 0 if it has not), and whether it is
    archived."""

    campaign: Campaign
    visibility: Visibility = "lab"
    ended_at: int = 0
    archived: bool = False

    @property
    def status(self) -> str:
        return "completed" if self.ended_at and self.campaign.status == "open" else self.campaign.status


class RowHistory(msgspec.Struct):
    """``status``: not submitted, refused, or the status of its run. ``results`` are the results of its steps
    by key; times in UTC ns."""

    row: int
    status: str = "not submitted"
    run: str = ""
    why: str = ""
    payload: dict[str, Any] = {}
    results: dict[str, Any] = {}
    started_at: int = 0
    ended_at: int = 0


def list_campaign_histories(log: Log) -> dict[str, CampaignHistory]:
    """Every campaign of the log, in order of its submission."""
    folded, handlers = Campaigns(), list_handlers(vars(campaigns), Campaigns)
    histories: dict[str, CampaignHistory] = {}
    for event, head in decode_events(log.select(LogQuery(types=TYPES))):
        if isinstance(event, CampaignCompleted):
            histories[event.campaign].ended_at = head.recorded_at
        elif isinstance(event, CampaignArchived | CampaignUnarchived):
            histories[event.campaign].archived = isinstance(event, CampaignArchived)
        handler = handlers.get(type(event))
        if handler is not None:
            handler(folded, event, head.recorded_at)
        if isinstance(event, CampaignSubmitted):
            histories[event.campaign] = CampaignHistory(folded.open[event.campaign], event.visibility)
    return histories


def read_campaign_history(log: Log, name: str) -> CampaignHistory:
    """Raises NotFound."""
    found = list_campaign_histories(log).get(name)
    if found is None:
        raise NotFound(f"There is no campaign {name!r} in this log.", remedy="List them: labos campaign list")
    return found


def list_campaign_rows(log: Log, name: str) -> list[RowHistory]:
    """The rows of a campaign that were submitted or refused, in order. Raises NotFound."""
    known = False
    rows: dict[int, RowHistory] = {}
    book = RunBook(read_catalogue(log))
    for event, head in decode_events(log.select(LogQuery(correlation=name))):
        known = known or isinstance(event, CampaignEvent)
        if isinstance(event, CampaignRowRefused):
            rows[event.row] = RowHistory(event.row, "refused", why=event.why)
        elif isinstance(event, RunSubmitted) and event.row is not None:
            rows[event.row] = RowHistory(event.row, run=event.run, payload=event.payload)
        book.add(event, head)
    if not known:
        raise NotFound(f"There is no campaign {name!r} in this log.", remedy="List them: labos campaign list")
    for row in rows.values():
        story = book.runs.get(row.run)
        if story is not None:
            row.status, row.why = story.status, story.why
            row.started_at, row.ended_at = story.started_at, story.ended_at
            row.results = {step.key: step.result for step in story.steps if step.result is not None}
    return [rows[number] for number in sorted(rows)]
