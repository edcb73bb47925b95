"""The calls of a client about what waits for an approval, and about the policy."""

from __future__ import annotations

from typing import Any

from labos.client._calls import Calls


class ApprovalCalls(Calls):
    """Proposals, and the policy that says what is one."""

    def approvals(self) -> list[dict[str, Any]]:
        """What waits for an approval, the oldest first: ``subject``, ``digest``, ``why`` and the like."""
        found: list[dict[str, Any]] = self._get("/approvals")["approvals"]
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

    def policy(self) -> dict[str, Any]:
        """The ``policy`` that holds, and the digest of its file (``applied``)."""
        return self._get("/policy")

    def apply_policy(self, text: str, file: str, by: str) -> None:
        """Let the policy be as the text of a file says."""
        self._post("/policy", {"text": text, "name": file, "by": by}, repeat=True)
