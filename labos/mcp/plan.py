"""Tools that plan: they check possible proposals and change nothing."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from typing import Any

from labos.client import LabClient
from labos.mcp.pages import LONGEST, cut, encode_answer

USER = "agent"
"""The name under which an agent proposes in a lab without users."""


class Plan:
    """Tools that check a workflow or a campaign before it is proposed."""

    def __init__(self, lab: LabClient) -> None:
        self._lab = lab

    def check_workflow(
        self,
        workflow: str,
        payload: dict[str, Any] | None = None,
        workcell: str = "",
        priority: int = 0,
        files: dict[str, str] | None = None,
    ) -> str:
        """Checks the text of a workflow (YAML) and describes a run of it: its steps, their durations and
        consumption, dangerous steps, and the reason why it would wait for an approval. Nothing is submitted.
        `payload` are its values; `files` are the texts of the files that its arguments name, by name."""
        checked = self._lab.check(
            workflow_of(workflow, files),
            payload=payload or {},
            user=USER,
            workcell=workcell,
            priority=priority,
            propose=True,
        )
        return encode_answer(cut(checked, LONGEST))

    def check_campaign(
        self,
        campaign: str,
        workflow: str,
        tables: dict[str, str] | None = None,
        files: dict[str, str] | None = None,
    ) -> str:
        """Checks the text of a campaign (YAML) row by row with the text of its workflow, and estimates what
        all rows need. Nothing is submitted. `tables` are the texts of the tables that it names, by name."""
        checked = self._lab.submit_campaign(
            campaign_of(campaign, workflow, tables, files), user=USER, dry_run=True
        )
        return encode_answer(cut(checked["estimate"], LONGEST))


def workflow_of(text: str, files: Mapping[str, str] | None) -> dict[str, Any]:
    return {"text": text, "name": "workflow.yaml", "files": _encode(files)}


def campaign_of(
    text: str, workflow: str, tables: Mapping[str, str] | None, files: Mapping[str, str] | None
) -> dict[str, Any]:
    workflow_text = workflow_of(workflow, files)
    return {"text": text, "name": "campaign.yaml", "workflow": workflow_text, "files": _encode(tables)}


def _encode(files: Mapping[str, str] | None) -> dict[str, str]:
    return {name: b64encode(text.encode()).decode() for name, text in (files or {}).items()}
