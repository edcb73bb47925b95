"""The operations of labos/http/routes/approvals.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedApprovals(Calls):
    """One method for each operation."""

    def _list_approvals(self, *, after: str = "", limit: int = 100) -> dict[str, Any]:
        """What waits for an approval, and why. The oldest first, a page of them: ask again with ``after`` =
        the last ``subject`` while there are ``more``. ``after``: only what waits behind this one; if it waits
        no more, all. ``limit``: so many; 100 if left out. Returns ``approvals``, ``more``."""
        return self._get("/approvals", after=after, limit=limit)

    def approval_of(self, subject: str) -> dict[str, Any]:
        """What waits for an approval, and how it differs from what was approved before. Returns ``proposal``,
        ``differences``."""
        return self._get(f"/approvals/{in_path(subject)}")

    def approval_forecast(self, subject: str) -> dict[str, Any]:
        """What a submission that waits for an approval would bring. It is taken as approved now, as it is.
        Nothing is approved by that. Of an experiment nothing can be forecast: its application decides as it
        goes. Returns ``forecast``, ``consumables``. Raises Refused."""
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
        """Let a submission go on, as it is or with changes. Only what bears this digest can be approved: what
        was changed since it was looked at is refused. An operator approves, who is not the user unless the
        policy says so, and never a program. ``digest``: of the proposal that was looked at; its first 12
        characters are enough. ``comment``: a word about it for the log. ``priority``: in place of what was
        asked. ``deadline``: a time, or how long from now (``12h``); empty for none. ``runs``: so many runs at
        most; 0 for no limit. ``lab_time_s``: so much module time at most; 0 for no limit. ``consumables``: so
        much at most, by kind of consumable. ``alike``: of a run of an experiment: further runs of its
        workflow in it, with other values, need none. Returns the digest. Raises Refused."""
        return self._post(
            f"/approvals/{in_path(subject)}/approve",
            {
                "by": by,
                "digest": digest,
                "comment": comment,
                "priority": priority,
                "deadline": deadline,
                "runs": runs,
                "lab_time_s": lab_time_s,
                "consumables": consumables,
                "alike": alike,
            },
            repeat=True,
        )["digest"]

    def refuse(self, subject: str, by: str, *, comment: str = "") -> str:
        """Do not let a submission go on. It is cancelled. A change of a campaign is not made, and the
        campaign goes on as before. ``comment``: a word about it for the log. Returns the digest. Raises
        Refused."""
        return self._post(
            f"/approvals/{in_path(subject)}/refuse", {"by": by, "comment": comment}, repeat=True
        )["digest"]

    def policy(self) -> dict[str, Any]:
        """Which submissions wait for an approval, and how high a priority may be. Returns ``applied``,
        ``policy``."""
        return self._get("/policy")

    def apply_policy(self, text: str, file: str, by: str) -> None:
        """Let the policy be as a file says. What waits already goes on waiting. ``text``: the file. ``file``:
        what errors call the file. Raises Refused, BadInput."""
        self._post("/policy", {"text": text, "name": file, "by": by}, repeat=True)
