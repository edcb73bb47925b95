"""Tools that plan: they check possible proposals and change nothing. And tools that propose: their
submissions wait until an operator has approved them."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from typing import Any

from labos.client import LabClient
from labos.mcp.pages import LONGEST, cut, encode_answer

USER = "agent"
"""The name under which an agent proposes in a lab without users."""

WAITS = "It has not started; it starts only if an operator approves it."


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
            _workflow_of(workflow, files),
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
            _campaign_of(campaign, workflow, tables, files), user=USER, dry_run=True
        )
        return encode_answer(cut(checked["estimate"], LONGEST))


class Propose:
    """Tools for submissions that always wait for an approval, also if the lab's policy and the token do not
    require it."""

    def __init__(self, lab: LabClient) -> None:
        self._lab = lab

    def propose_run(
        self,
        workflow: str,
        payload: dict[str, Any] | None = None,
        workcell: str = "",
        priority: int = 0,
        files: dict[str, str] | None = None,
        key: str = "",
    ) -> str:
        """Proposes a run of a workflow (its text, YAML). It waits until an operator has approved it; you
        cannot start it. Check it first with `check_workflow`. Two proposals with the same `key` count as
        one."""
        run = self._lab.submit(
            _workflow_of(workflow, files),
            payload or {},
            user=USER,
            workcell=workcell,
            priority=priority,
            request=key,
            propose=True,
        )
        return encode_answer({"run": run, "warnings": self._lab.warnings}, meaning=WAITS)

    def propose_campaign(
        self,
        campaign: str,
        workflow: str,
        tables: dict[str, str] | None = None,
        files: dict[str, str] | None = None,
        key: str = "",
    ) -> str:
        """Proposes a campaign (its text, YAML): a workflow for each row of a table. It waits until an
        operator has approved it; you cannot start it. Check it first with `check_campaign`. Two proposals
        with the same `key` count as one."""
        answer = self._lab.submit_campaign(
            _campaign_of(campaign, workflow, tables, files), user=USER, request=key, propose=True
        )
        return encode_answer({"campaign": answer["campaign"], "why": answer["approval"]}, meaning=WAITS)

    def propose_clone(self, campaign: str, name: str = "", priority: int | None = None, key: str = "") -> str:
        """Proposes a copy of a campaign, with the same rows and workflow. `campaign` is the id of the
        original, such as C3, which may have ended; `name` is the name of the copy. It waits until an operator
        has approved it; you cannot start it. Two proposals with the same `key` count as one."""
        answer = self._lab.clone_campaign(
            campaign, USER, request=key, name=name, priority=priority, propose=True
        )
        return encode_answer({"campaign": answer["campaign"], "why": answer["approval"]}, meaning=WAITS)


def _workflow_of(text: str, files: Mapping[str, str] | None) -> dict[str, Any]:
    return {"text": text, "name": "workflow.yaml", "files": _encode(files)}


def _campaign_of(
    text: str, workflow: str, tables: Mapping[str, str] | None, files: Mapping[str, str] | None
) -> dict[str, Any]:
    workflow_text = _workflow_of(workflow, files)
    return {"text": text, "name": "campaign.yaml", "workflow": workflow_text, "files": _encode(tables)}


def _encode(files: Mapping[str, str] | None) -> dict[str, str]:
    return {name: b64encode(text.encode()).decode() for name, text in (files or {}).items()}
