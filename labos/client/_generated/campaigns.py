"""The operations of labos/http/routes/campaigns.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedCampaigns(Calls):
    """One method for each operation."""

    def campaigns(self) -> list[dict[str, Any]]:
        """List the campaigns that have not been completed."""
        return self._get("/campaigns")["campaigns"]

    def _submit_campaign_file(
        self,
        text: str,
        workflow: Mapping[str, Any],
        user: str,
        *,
        name: str = "campaign",
        files: Mapping[str, bytes] | None = None,
        dry_run: bool = False,
        propose: bool = False,
        request: str = "",
    ) -> dict[str, Any]:
        """Check a campaign and submit it. The campaign is checked row by row. If a row cannot be carried out,
        nothing is submitted, and ``details`` of the problem lists each fault with its row. ``text``: the
        campaign file. ``workflow``: the workflow, with the files that it names. ``user``: the user who asks;
        ignored in a lab that has users, where it is the user who has signed in. ``name``: the name of the
        file in error messages. ``files``: the table file of the campaign, in base64, by the name that the
        campaign file uses. ``dry_run``: only check it. ``propose``: wait for an approval, also if the policy
        does not require one. Returns ``campaign``, ``estimate``, ``approval``. Raises NotFound, Refused,
        BadInput."""
        files = files or {}
        return self._post("/campaigns", locals(), once=True, timeout_s=900.0)

    def campaign(self, campaign: str) -> dict[str, Any]:
        """Show the progress and the terms of a campaign that has not been completed. Returns ``id``,
        ``name``, ``user``, ``workflow``, ``workcell``, ``status``, ``why``, ``rows``, ``queued``, ``active``,
        ``completed``, ``failed``, ``cancelled``, ``refused``, ``left``, ``lab_time_s``, ``used``, ``terms``,
        ``visibility``, ``cloned_from``."""
        return self._get(f"/campaigns/{in_path(campaign)}")

    def pause_campaign(self, campaign: str, by: str, *, why: str = "") -> None:
        """Pause a campaign: no further row is submitted. Its waiting runs are paused; runs that have started
        continue. ``why``: a reason or comment for the log. Raises Refused."""
        self._post("/campaigns/{campaign}/pause", locals(), repeat=True)

    def resume_campaign(self, campaign: str, by: str) -> None:
        """Resume a paused campaign. Raises Refused."""
        self._post("/campaigns/{campaign}/resume", locals(), repeat=True)

    def cancel_campaign(self, campaign: str, by: str, *, why: str = "", stay: bool = False) -> None:
        """Cancel a campaign. No further row is submitted, and its runs are cancelled. ``why``: a reason or
        comment for the log. ``stay``: labware of its runs stays where it is. Raises Refused."""
        self._post("/campaigns/{campaign}/cancel", locals(), repeat=True)

    def _amend_campaign(
        self,
        campaign: str,
        by: str,
        *,
        priority: int | None = None,
        deadline: str | None = None,
        runs: int | None = None,
        lab_time_s: float | None = None,
        consumables: Mapping[str, float] | None = None,
        tags: Sequence[str] | None = None,
        until: str | None = None,
        stop_after: int | None = None,
    ) -> dict[str, Any]:
        """Change the terms of a campaign. Fields that are left out do not change. A change that allows the
        campaign more may need an approval; until then, the terms in the answer are valid. ``priority``: the
        priority of rows that are submitted from now on. ``deadline``: a time, or a duration from now
        (``12h``); empty for none. ``runs``: the largest number of runs; 0 for no limit. ``lab_time_s``: the
        most module time, in lab seconds; 0 for no limit. ``consumables``: the largest amounts, by kind of
        consumable. ``tags``: its tags; they replace the present ones. ``until``: the stop rule; empty for
        none. ``stop_after``: the number of failed runs at which the campaign stops; 0 for no limit. Returns
        ``campaign``, ``terms``, ``approval``. Raises Refused."""
        return self._post("/campaigns/{campaign}/amend", locals(), repeat=True)

    def _clone_a_campaign(
        self,
        campaign: str,
        by: str,
        *,
        priority: int | None = None,
        deadline: str | None = None,
        runs: int | None = None,
        lab_time_s: float | None = None,
        consumables: Mapping[str, float] | None = None,
        tags: Sequence[str] | None = None,
        until: str | None = None,
        stop_after: int | None = None,
        name: str = "",
        visibility: str | None = None,
        dry_run: bool = False,
        propose: bool = False,
        request: str = "",
    ) -> dict[str, Any]:
        """Submit a copy of a campaign. The copy has the same rows and the same workflow, and is checked like
        a new campaign. It belongs to the user who asks. A campaign that has ended can be copied too. Fields
        that are left out are as in the original, except the deadline: the copy has none. ``priority``: the
        priority of rows that are submitted from now on. ``deadline``: a time, or a duration from now
        (``12h``); empty for none. ``runs``: the largest number of runs; 0 for no limit. ``lab_time_s``: the
        most module time, in lab seconds; 0 for no limit. ``consumables``: the largest amounts, by kind of
        consumable. ``tags``: its tags; they replace the present ones. ``until``: the stop rule; empty for
        none. ``stop_after``: the number of failed runs at which the campaign stops; 0 for no limit. ``name``:
        the name of the new campaign; empty: the name of the original. ``visibility``: who sees it: lab, group
        or private. ``dry_run``: only check it. ``propose``: wait for an approval, also if the policy does not
        require one. Returns ``campaign``, ``estimate``, ``approval``. Raises NotFound, Refused, BadInput."""
        return self._post("/campaigns/{campaign}/clone", locals(), once=True, timeout_s=900.0)

    def archive_campaign(self, campaign: str, by: str, *, undo: bool = False) -> None:
        """Hide a campaign that has ended from lists. Nothing is deleted. ``undo``: show it in lists again.
        Raises NotFound, Refused."""
        self._post("/campaigns/{campaign}/archive", locals(), repeat=True)

    def shares(self) -> list[dict[str, Any]]:
        """Show each user's share of the lab, and the use so far. Returns the accounts."""
        return self._get("/shares")["accounts"]

    def apply_shares(self, text: str, file: str, by: str) -> None:
        """Apply a shares file with weights and quotas. ``text``: the file. ``file``: the name of the file in
        error messages. Raises Refused, BadInput."""
        self._post("/shares", {"text": text, "name": file, "by": by}, repeat=True)
