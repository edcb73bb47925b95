"""Campaigns as rows."""

from __future__ import annotations

from labos.audit._rows import Row, RowChanges, convert_to_seconds
from labos.audit._work_tables import CAMPAIGNS, RUNS
from labos.core import campaigns as c
from labos.core import runs as r
from labos.core.envelope import Envelope


def on_submitted(rows: RowChanges, event: c.CampaignSubmitted, head: Envelope, at: float) -> None:
    row = rows.put(
        CAMPAIGNS,
        event,
        user_id=event.user,
        status="open",
        submitted_at_s=at,
        runs=0,
        completed=0,
        failed=0,
        cancelled=0,
        refused=0,
        row_table=event.table,
        submitted_position=head.position,
    )
    set_terms(row, event.terms)


def on_amended(rows: RowChanges, event: c.CampaignAmended, head: Envelope, at: float) -> None:
    set_terms(rows.change(CAMPAIGNS, event.campaign), event.terms)


def set_terms(row: Row, terms: c.Terms) -> None:
    """The campaign continues with these terms."""
    row["priority"], row["tags"] = terms.priority, list(terms.tags)
    row["deadline_s"] = convert_to_seconds(terms.deadline) if terms.deadline else None


def on_paused(rows: RowChanges, event: c.CampaignPaused, head: Envelope, at: float) -> None:
    rows.update(CAMPAIGNS, event.campaign, status="paused", why=event.why)


def on_resumed(rows: RowChanges, event: c.CampaignResumed, head: Envelope, at: float) -> None:
    rows.update(CAMPAIGNS, event.campaign, status="open", why="")


def on_stopped(rows: RowChanges, event: c.CampaignStopped, head: Envelope, at: float) -> None:
    rows.update(CAMPAIGNS, event.campaign, status="stopped", why=event.why, by_run=event.by_run)


def on_cancelled(rows: RowChanges, event: c.CampaignCancelled, head: Envelope, at: float) -> None:
    rows.update(CAMPAIGNS, event.campaign, status="cancelled", why=event.why)


def on_completed(rows: RowChanges, event: c.CampaignCompleted, head: Envelope, at: float) -> None:
    row = rows.update(CAMPAIGNS, event.campaign, ended_at_s=at, ended_position=head.position)
    if row["status"] not in ("stopped", "cancelled"):
        row["status"], row["why"] = "completed", event.why


def on_archived(
    rows: RowChanges, event: c.CampaignArchived | c.CampaignUnarchived, head: Envelope, at: float
) -> None:
    rows.update(CAMPAIGNS, event.campaign, archived=isinstance(event, c.CampaignArchived))


def on_row_refused(rows: RowChanges, event: c.CampaignRowRefused, head: Envelope, at: float) -> None:
    rows.change(CAMPAIGNS, event.campaign)["refused"] += 1


def on_run_submitted(rows: RowChanges, event: r.RunSubmitted, head: Envelope, at: float) -> None:
    rows.change(CAMPAIGNS, event.campaign)["runs"] += 1


def on_run_ended(rows: RowChanges, event: r.RunEnd, head: Envelope, at: float) -> None:
    row = rows.change(CAMPAIGNS, rows.get(RUNS, event.run)["campaign"])
    row[event.TYPE.rpartition(".")[2]] += 1  # its columns have the names of the outcomes
