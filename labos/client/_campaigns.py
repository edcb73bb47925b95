"""The calls of a client about campaigns, and about the shares of those who use the lab."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from labos.client._calls import Calls
from labos.client._files import campaign_text

CAMPAIGN_S = 900.0
"""How long a lab may take to check a campaign."""


class CampaignCalls(Calls):
    """A workflow carried out once for each row of a table, and the ledger of lab time."""

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
        ``campaign`` (empty if only checked, with ``dry_run``) and what it asks of the lab as ``estimate``.
        The same ``request`` twice is one campaign. With ``propose`` it waits for an approval; ``approval`` of
        the answer says why it does. In place of a file, a mapping has its ``text`` and its ``workflow``."""
        text = campaign if isinstance(campaign, Mapping) else campaign_text(campaign)
        body = {**text, "user": user, "dry_run": dry_run, **({"propose": True} if propose else {})}
        return self._post("/campaigns", body, request=request or self._ids.new(), timeout_s=CAMPAIGN_S)

    def forecast_campaign(self, campaign: str | Path | Mapping[str, Any], *, user: str) -> dict[str, Any]:
        """Check a campaign file as ``submit_campaign`` does, and submit nothing: what it asks of the lab as
        ``estimate``, and what it would bring as ``forecast``."""
        text = campaign if isinstance(campaign, Mapping) else campaign_text(campaign)
        return self._post("/campaigns/forecast", {**text, "user": user}, repeat=True, timeout_s=CAMPAIGN_S)

    def campaigns(self) -> list[dict[str, Any]]:
        """The campaigns that have not been completed."""
        found: list[dict[str, Any]] = self._get("/campaigns")["campaigns"]
        return found

    def campaign(self, campaign: str) -> dict[str, Any]:
        """A campaign that has not been completed: how far it is, and its terms. Raises NotFound."""
        return self._get(f"/campaigns/{campaign}")

    def pause_campaign(self, campaign: str, by: str, *, why: str = "") -> None:
        """Submit no further row and start no run that waits; runs under way go on."""
        self._post(f"/campaigns/{campaign}/pause", {"by": by, "why": why}, repeat=True)

    def resume_campaign(self, campaign: str, by: str) -> None:
        self._post(f"/campaigns/{campaign}/resume", {"by": by}, repeat=True)

    def cancel_campaign(self, campaign: str, by: str, *, why: str = "", stay: bool = False) -> None:
        """Submit no further row, and cancel its runs as ``cancel`` does."""
        self._post(f"/campaigns/{campaign}/cancel", {"by": by, "why": why, "stay": stay}, repeat=True)

    def amend_campaign(self, campaign: str, by: str, **changes: Any) -> dict[str, Any]:
        """Let a campaign go on under other terms. Returns those that hold: a change that waits for an
        approval (``approval`` of the client says so) is not among them. Changes: ``priority``, ``deadline``,
        ``runs``, ``lab_time_s``, ``consumables``, ``tags``, ``until``, ``stop_after``."""
        found: dict[str, Any] = self._post(f"/campaigns/{campaign}/amend", {"by": by, **changes}, repeat=True)
        self.approval = str(found.get("approval", ""))
        return dict(found["terms"])

    def shares(self) -> list[dict[str, Any]]:
        """Who is to have which part of the lab (``wanted``), and who has had which (``had``)."""
        found: list[dict[str, Any]] = self._get("/shares")["accounts"]
        return found

    def apply_shares(self, text: str, file: str, by: str) -> None:
        """Let weights and quotas be as the text of a shares file says."""
        self._post("/shares", {"text": text, "name": file, "by": by}, repeat=True)
