"""Calls of a client about campaigns and approvals that are more than one request."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from labos.client._files import campaign_text
from labos.client._generated import GeneratedCalls

PAGE = 500


class CampaignCalls(GeneratedCalls):
    """Campaigns from files, and submissions that wait for an approval."""

    def submit_campaign(
        self,
        campaign: str | Path | Mapping[str, Any],
        *,
        user: str,
        dry_run: bool = False,
        request: str = "",
        propose: bool = False,
    ) -> dict[str, Any]:
        """Check a campaign file with its table and workflow, row by row, and submit it. Returns its id as
        ``campaign`` (empty if only checked, with ``dry_run``) and its needs as ``estimate``. The same
        ``request`` twice is one campaign. With ``propose`` it waits for an approval; ``approval`` of the
        answer is the reason. Instead of a file, give a mapping with its ``text`` and its ``workflow``."""
        return self._submit_campaign_file(
            **campaign_text(campaign), user=user, dry_run=dry_run, request=request, propose=propose
        )

    def forecast_campaign(self, campaign: str | Path | Mapping[str, Any], *, user: str) -> dict[str, Any]:
        """Check a campaign file as ``submit_campaign`` does, and submit nothing. Returns its needs as
        ``estimate``, and its expected times and the delays of others as ``forecast``."""
        return self._forecast_campaign_file(**campaign_text(campaign), user=user)

    def amend_campaign(self, campaign: str, by: str, **changes: Any) -> dict[str, Any]:
        """Change the terms of a campaign. Returns the terms in force: a change that waits for an approval
        (see ``approval`` of the client) is not among them. Changes: ``priority``, ``deadline``, ``runs``,
        ``lab_time_s``, ``consumables``, ``tags``, ``until``, ``stop_after``."""
        found = self._amend_campaign(campaign, by, **changes)
        self.approval = str(found.get("approval", ""))
        return dict(found["terms"])

    def clone_campaign(self, campaign: str, by: str, *, request: str = "", **changes: Any) -> dict[str, Any]:
        """Submit a copy of a campaign, also of one that has ended; returns as ``submit_campaign``. Changes:
        ``name``, ``visibility``, ``dry_run``, ``propose``, and those of ``amend_campaign``."""
        return self._clone_a_campaign(campaign, by, request=request, **changes)

    def approvals(self) -> list[dict[str, Any]]:
        """The submissions that wait for an approval, the oldest first: ``subject``, ``digest``, ``why`` and
        further fields."""
        found: list[dict[str, Any]] = []
        more = True
        while more:
            page = self._list_approvals(after=found[-1]["subject"] if found else "", limit=PAGE)
            found += page["approvals"]
            more = page["more"] and bool(page["approvals"])
        return found
