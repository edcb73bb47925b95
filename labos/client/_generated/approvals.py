"""The operations of labos/http/routes/approvals.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedApprovals(Calls):
    """One method for each operation."""

    def _list_approvals(self, *, after: str = "", limit: int = 100) -> dict[str, Any]:
        """List the submissions that wait for an approval. A page of them, the oldest first. While there are
        ``more``, ask for the next page with ``after`` = the last ``subject``. ``after``: only submissions
        after this one; all of them if it no longer waits. ``limit``: the largest number in an answer; 100 if
        left out. Returns ``approvals``, ``more``."""
        return self._get("/approvals", after=after, limit=limit)

    def approval_of(self, subject: str) -> dict[str, Any]:
        """Show a submission that waits for an approval, and how it differs from the last approved one.
        Returns ``proposal``, ``differences``."""
        return self._get(f"/approvals/{in_path(subject)}")

    def approval_forecast(self, subject: str) -> dict[str, Any]:
        """Forecast a submission that waits for an approval. The forecast assumes that the submission is
        approved now, without changes. This does not approve it. An experiment cannot be forecast, because its
        application decides while it runs. Returns ``forecast``, ``consumables``. Raises Refused."""
        return self._get(f"/approvals/{in_path(subject)}/forecast")

    def approve(
        self,
        subject: str,
        by: str,
        digest: str,
        *,
        comment: str = "",
        priority: int | None = None,
        deadline: str | None = None,
        runs: int | None = None,
        lab_time_s: float | None = None,
        consumables: Mapping[str, float] | None = None,
        alike: bool = False,
    ) -> str:
        """Approve a submission, as it is or with changes. Only the submission with this digest can be
        approved: the request is refused if the submission has changed since the operator looked at it. An
        operator approves; the policy says whether it may be the submitting user. A program cannot approve.
        ``digest``: the digest of the submission that the operator looked at; the first 12 characters are
        enough. ``comment``: a reason or comment for the log. ``priority``: a priority that replaces the
        requested one. ``deadline``: a time, or a duration from now (``12h``); empty for none. ``runs``: the
        largest number of runs; 0 for no limit. ``lab_time_s``: the most module time, in lab seconds; 0 for no
        limit. ``consumables``: the largest amounts, by kind of consumable. ``alike``: for a run of an
        experiment: further runs of its workflow there need no approval. Returns the digest. Raises
        Refused."""
        return self._post("/approvals/{subject}/approve", locals(), repeat=True)["digest"]

    def refuse(self, subject: str, by: str, *, comment: str = "") -> str:
        """Refuse a submission. The submission is cancelled. If it is a change of a campaign, the campaign
        continues unchanged. ``comment``: a reason or comment for the log. Returns the digest. Raises
        Refused."""
        return self._post("/approvals/{subject}/refuse", locals(), repeat=True)["digest"]

    def policy(self) -> dict[str, Any]:
        """Show the policy: which submissions need an approval, and the highest priority. Returns ``applied``,
        ``policy``."""
        return self._get("/policy")

    def apply_policy(self, text: str, file: str, by: str) -> None:
        """Apply a policy file. Submissions that wait already continue to wait. ``text``: the file. ``file``:
        the name of the file in error messages. Raises Refused, BadInput."""
        self._post("/policy", {"text": text, "name": file, "by": by}, repeat=True)
