"""The calls of a client about what waits for an approval, and about the policy."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

from labos.client._calls import Calls
from labos.client._files import workflow_text

PAGE = 500


FORECAST_S = 180.0
"""How long a lab may take for a forecast."""


class ApprovalCalls(Calls):
    """Proposals, and the policy that says what is one."""

    def approvals(self) -> list[dict[str, Any]]:
        """What waits for an approval, the oldest first: ``subject``, ``digest``, ``why`` and the like."""
        found: list[dict[str, Any]] = []
        more = True
        while more:
            after = found[-1]["subject"] if found else ""
            page = self._get("/approvals", after=after, limit=PAGE)
            found += page["approvals"]
            more = page["more"] and bool(page["approvals"])
        return found

    def approval_of(self, subject: str) -> dict[str, Any]:
        """What waits for an approval (``proposal``), and its ``differences`` from what was approved last of
        its name. Raises NotFound."""
        return self._get(f"/approvals/{subject}")

    def approve(self, subject: str, by: str, digest: str, *, comment: str = "", **changes: Any) -> str:
        """Let a submission go on as it is with this digest, which is returned whole. Changes: ``priority``,
        ``deadline``, ``runs``, ``lab_time_s``, ``consumables``, ``alike``."""
        body = {"by": by, "digest": digest, "comment": comment, **changes}
        return str(self._post(f"/approvals/{subject}/approve", body, repeat=True)["digest"])

    def refuse(self, subject: str, by: str, *, comment: str = "") -> str:
        """Do not let a submission go on; returns its digest."""
        body = {"by": by, "comment": comment}
        return str(self._post(f"/approvals/{subject}/refuse", body, repeat=True)["digest"])

    def actions(self, module: str) -> dict[str, Any]:
        """What a module can do: its ``actions``, with their ``arguments``. Raises NotFound."""
        return self._get(f"/modules/{quote(module, safe='')}/actions")

    def check(self, workflow: str | Path | Mapping[str, Any], **options: Any) -> dict[str, Any]:
        """What a run of a workflow would be: its ``steps``, its ``demand``, why it would wait for an
        ``approval`` or be refused (``refusal``). Nothing is submitted. Options are those of ``submit``, and
        ``payload``. Raises as ``submit``."""
        payload = options.pop("payload", None) or {}
        body = {"workflow": workflow_text(workflow, payload), "payload": dict(payload), **options}
        return self._post("/runs/check", body, repeat=True)

    def forecast_run(self, workflow: str | Path | Mapping[str, Any], **options: Any) -> dict[str, Any]:
        """When a run of a workflow would start and end, and what it would bring, as ``forecast``. Nothing is
        submitted. Options are those of ``check``."""
        payload = options.pop("payload", None) or {}
        body = {"workflow": workflow_text(workflow, payload), "payload": dict(payload), **options}
        return self._post("/runs/forecast", body, repeat=True, timeout_s=FORECAST_S)

    def forecast(self) -> dict[str, Any]:
        """When runs start and end, and when a person is needed (``forecast``), and which actions take longer
        or shorter than they did (``drifts``)."""
        return self._get("/forecast")

    def policy(self) -> dict[str, Any]:
        """The ``policy`` that holds, and the digest of its file (``applied``)."""
        return self._get("/policy")

    def apply_policy(self, text: str, file: str, by: str) -> None:
        """Let the policy be as the text of a file says."""
        self._post("/policy", {"text": text, "name": file, "by": by}, repeat=True)
