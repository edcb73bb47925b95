"""Tools that propose: their submissions wait until an operator has approved them."""

from __future__ import annotations

from typing import Any

from labos.client import LabClient
from labos.mcp.pages import encode_answer
from labos.mcp.plan import USER, campaign_of, workflow_of

WAITS = "It has not started; it starts only if an operator approves it."


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
            workflow_of(workflow, files),
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
            campaign_of(campaign, workflow, tables, files), user=USER, request=key, propose=True
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
