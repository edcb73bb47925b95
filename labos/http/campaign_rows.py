"""The rows of campaigns: read from their blobs, and planned shortly before their submission."""

from __future__ import annotations

import asyncio
from array import array
from typing import Any

import msgspec

from labos.core.campaigns import Campaign
from labos.core.decide.campaigns import RefuseRow, SubmitRow
from labos.core.ids import CampaignId
from labos.errors import BadInput
from labos.http.service import LabService, WorkflowText
from labos.ports import BlobReader
from labos.services.times import parse_time

_definition = msgspec.json.Decoder(WorkflowText)


class RowTable:
    """The rows of a campaign: the blob, and the position at which each row begins in it."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._starts = array("Q", [0])
        at = data.find(b"\n")
        while at >= 0:
            self._starts.append(at + 1)
            at = data.find(b"\n", at + 1)
        self._starts.append(len(data) + 1)

    def __len__(self) -> int:
        return len(self._starts) - 1

    def read_row(self, number: int) -> dict[str, Any]:
        found: dict[str, Any] = msgspec.json.decode(
            self._data[self._starts[number] : self._starts[number + 1] - 1]
        )
        return found


def read_table(blobs: BlobReader, digest: str) -> RowTable:
    return RowTable(blobs.get(digest))


def read_definition(blobs: BlobReader, digest: str) -> WorkflowText:
    return _definition.decode(blobs.get(digest))


def take_due(row: dict[str, Any], key: str) -> tuple[dict[str, Any], str]:
    """The payload of a row, and the due date of its run from the value of a key (empty: none)."""
    if not key:
        return row, ""
    due, payload = row.get(key), {name: value for name, value in row.items() if name != key}
    return payload, "" if due is None else str(due).strip()


def explain_no_time(due: str) -> str:
    """The fault of the due date of a row's run; empty if it is valid."""
    try:
        found = parse_time(due, 0) if due else 1
    except BadInput as error:
        return error.message
    return "" if found > 0 else f"{due!r} is not a calendar time."


class CampaignRows:
    """Plans rows of campaigns for the feeder. Keeps the tables of campaigns that are in progress."""

    def __init__(self, service: LabService) -> None:
        self._service = service
        self._known: dict[CampaignId, tuple[RowTable, WorkflowText]] = {}

    async def propose(self, campaign: Campaign, row: int) -> SubmitRow | RefuseRow:
        table, workflow = await self._read(campaign)
        payload, due = take_due(table.read_row(row), campaign.due)
        try:
            compiled = await self._service.compile(workflow, payload, campaign.workcell)
        except BadInput as error:
            return RefuseRow(campaign.id, row, str(error).replace("\n", " "))
        pins = self._service.list_pins(workflow, *compiled.plans)
        due_at = parse_time(due, 0) if due and not explain_no_time(due) else 0
        return SubmitRow(campaign.id, row, compiled.plan, payload, pins, compiled.others, due_at)

    async def _read(self, campaign: Campaign) -> tuple[RowTable, WorkflowText]:
        if campaign.id not in self._known:
            alive = self._service.kernel.state.campaigns.open
            self._known = {name: known for name, known in self._known.items() if name in alive}
            blobs = self._service.parts.blobs
            table = await asyncio.to_thread(read_table, blobs, campaign.table)
            definition = await asyncio.to_thread(read_definition, blobs, campaign.definition)
            self._known[campaign.id] = table, definition
        return self._known[campaign.id]
