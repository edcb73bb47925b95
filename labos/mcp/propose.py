"""Tools that propose: what they hand in waits until an operator has approved it."""

from __future__ import annotations

from typing import Any

from labos.client import LabClient
from labos.mcp.pages import encode_answer
from labos.mcp.plan import campaign_of, workflow_of

WAITS = "It has not begun, and begins only if an operator approves it."


class Propose:
    """Submissions that wait for an approval, whatever the lab's policy and the token would allow."""

    def __init__(self, lab: LabClient, user: str) -> None:
        self._lab, self._user = lab, user

    def propose_run(
        self,
        workflow: str,
        payload: dict[str, Any] | None = None,
        workcell: str = "",
        priority: int = 0,
        files: dict[str, str] | None = None,
        key: str = "",
    ) -> str:
        """Proposes a run of a workflow (its text, YAML). It waits until an operator has looked at it and
        approved it; you cannot start it. Check it first with `check_workflow`. The same `key` twice is one
        proposal."""
        run = self._lab.submit(
            workflow_of(workflow, files),
            payload or {},
            user=self._user,
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
        operator has looked at it and approved it; you cannot start it. Check it first with `check_campaign`.
        The same `key` twice is one proposal."""
        answer = self._lab.submit_campaign(
            campaign_of(campaign, workflow, tables, files), user=self._user, request=key, propose=True
        )
        return encode_answer({"campaign": answer["campaign"], "why": answer["approval"]}, meaning=WAITS)

    def propose_clone(self, campaign: str, name: str = "", priority: int | None = None, key: str = "") -> str:
        """Proposes a campaign once more, with the same rows and workflow; `campaign` is its id, as C3, also
        of one that has ended, and `name` that of the new one. It waits until an operator has looked at it
        and approved it; you cannot start it. The same `key` twice is one proposal."""
        answer = self._lab.clone_campaign(
            campaign, self._user, request=key, name=name, priority=priority, propose=True
        )
        return encode_answer({"campaign": answer["campaign"], "why": answer["approval"]}, meaning=WAITS)
