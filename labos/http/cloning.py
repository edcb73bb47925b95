"""A copy of a campaign: the same rows and the same workflow, checked in the present state of the lab."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec

from labos.core.approvals import ApprovalGiven
from labos.core.campaigns import CampaignAmended, CampaignSubmitted, Terms
from labos.errors import NotFound
from labos.http.bodies import Clone, NewCampaign
from labos.http.campaign_rows import read_definition, read_table
from labos.http.campaigns import Estimate, amend_terms, check_rows, keep_campaign
from labos.http.service import LabService
from labos.ports import LogQuery
from labos.services.log import Log, decode_events
from labos.spec.campaign import CampaignFile, CampaignSource, RowsEntry
from labos.spec.rows import TableLine
from labos.spec.source import parse


async def clone_campaign(
    service: LabService, name: str, asked: Clone, user: str, request: str
) -> tuple[str, Estimate]:
    """Submit a copy of a campaign, also of one that has ended; with ``dry_run``, only check it. Raises
    SpecErrors with each fault and its row, NotFound, Refused, KeyReused."""
    service.expect_role(user, "submitter")
    first, terms = await asyncio.to_thread(_read, service.parts.store, name)
    blobs = service.parts.blobs
    workflow = await asyncio.to_thread(read_definition, blobs, first.definition)
    table = await asyncio.to_thread(read_table, blobs, first.table)
    terms = amend_terms(msgspec.structs.replace(terms, deadline=0), asked, service.kernel.clock.now_ns())
    file = CampaignFile(
        labos=1,
        campaign=asked.name or first.name,
        workflow=workflow.name,
        rows=RowsEntry(),
        due=first.due,
        visibility=asked.visibility or service.kernel.state.campaigns.visibility_of(first.campaign),
    )
    rows = [TableLine(table.read_row(number), f"rows of {name}") for number in range(len(table))]
    content = CampaignSource(file, parse("labos: 1\n", f"campaign {name}"), rows, terms)
    new = NewCampaign(
        text="",
        workflow=workflow,
        user=user,
        name=f"campaign {name}",
        dry_run=asked.dry_run,
        propose=asked.propose,
    )
    checked = await check_rows(service, new, content, first.workcell)
    return await keep_campaign(service, checked, request, first.campaign)


def _read(log: Log, name: str) -> tuple[CampaignSubmitted, Terms]:
    """The submitted campaign, and its last terms. Raises NotFound."""
    kinds: tuple[Any, ...] = (CampaignSubmitted, CampaignAmended, ApprovalGiven)
    query = LogQuery(streams=(name,), types=tuple(kind.TYPE for kind in kinds))
    first: CampaignSubmitted | None = None
    terms = Terms()
    for event, _ in decode_events(log.select(query)):
        if isinstance(event, CampaignSubmitted):
            first, terms = event, event.terms
        elif isinstance(event, CampaignAmended | ApprovalGiven):
            terms = event.terms or terms
    if first is None:
        raise NotFound(f"There is no campaign {name!r}.", remedy="List them: labos campaign list")
    return first, terms
