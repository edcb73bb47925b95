"""The operations of labos/http/routes/campaigns.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedCampaigns(Calls):
    """One method for each operation."""

    def campaigns(self) -> list[dict[str, Any]]:
        """Campaigns that have not been completed."""
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
        """Check a campaign and submit it. It is checked row by row; if a row cannot be carried out, nothing
        is submitted, and ``details`` of the problem names each fault with its row. ``text``: the campaign
        file. ``workflow``: the workflow, with the files that it names. ``user``: who asks; not read in a lab
        that has users: there it is the user who has signed in. ``name``: what errors call the file.
        ``files``: the table that it names, in base64, by the name that it has for it. ``dry_run``: only check
        it. ``propose``: it waits for an approval, whatever the policy says. Returns ``campaign``,
        ``estimate``, ``approval``. Raises NotFound, Refused, BadInput."""
        return self._post(
            "/campaigns",
            {
                "text": text,
                "workflow": workflow,
                "user": user,
                "name": name,
                "files": files or {},
                "dry_run": dry_run,
                "propose": propose,
            },
            request=request or self._ids.new(),
            timeout_s=900.0,
        )

    def campaign(self, campaign: str) -> dict[str, Any]:
        """A campaign that has not been completed: how far it is, and its terms. Returns ``id``, ``name``,
        ``user``, ``workflow``, ``workcell``, ``status``, ``why``, ``rows``, ``queued``, ``active``,
        ``completed``, ``failed``, ``cancelled``, ``refused``, ``left``, ``lab_time_s``, ``used``, ``terms``,
        ``visibility``, ``cloned_from``."""
        return self._get(f"/campaigns/{in_path(campaign)}")

    def pause_campaign(self, campaign: str, by: str, *, why: str = "") -> None:
        """Submit no further row of a campaign until it is resumed. Its runs that wait are paused, those under
        way go on. ``why``: a word about it for the log. Raises Refused."""
        self._post(f"/campaigns/{in_path(campaign)}/pause", {"by": by, "why": why}, repeat=True)

    def resume_campaign(self, campaign: str, by: str) -> None:
        """Go on with a campaign that is paused. Raises Refused."""
        self._post(f"/campaigns/{in_path(campaign)}/resume", {"by": by}, repeat=True)

    def cancel_campaign(self, campaign: str, by: str, *, why: str = "", stay: bool = False) -> None:
        """Cancel a campaign. No further row is submitted, and its runs are cancelled. ``why``: a word about
        it for the log. ``stay``: the labware of its runs stays where it is. Raises Refused."""
        self._post(
            f"/campaigns/{in_path(campaign)}/cancel", {"by": by, "why": why, "stay": stay}, repeat=True
        )

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
        """Let a campaign go on under other terms. What is left out stays as it is. A change by which it may
        do more may wait for an approval; until then it goes on under the terms that are answered.
        ``priority``: of rows that are submitted from now on. ``deadline``: a time, or how long from now
        (``12h``); empty for none. ``runs``: so many runs at most; 0 for no limit. ``lab_time_s``: so much
        module time at most; 0 for no limit. ``consumables``: so much at most, by kind of consumable.
        ``tags``: its tags, in place of those it has. ``until``: the stop rule; empty for none.
        ``stop_after``: so many rows may fail; 0 for however many. Returns ``campaign``, ``terms``,
        ``approval``. Raises Refused."""
        return self._post(
            f"/campaigns/{in_path(campaign)}/amend",
            {
                "by": by,
                "priority": priority,
                "deadline": deadline,
                "runs": runs,
                "lab_time_s": lab_time_s,
                "consumables": consumables,
                "tags": tags,
                "until": until,
                "stop_after": stop_after,
            },
            repeat=True,
        )

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
        """Submit a campaign once more. It has the same rows and the same workflow, and is checked like a new
        one. It is the user who asks who gets it. A campaign that has ended can be cloned, too. What is left
        out is as in the campaign that is cloned, but for its deadline: the clone has none. ``priority``: of
        rows that are submitted from now on. ``deadline``: a time, or how long from now (``12h``); empty for
        none. ``runs``: so many runs at most; 0 for no limit. ``lab_time_s``: so much module time at most; 0
        for no limit. ``consumables``: so much at most, by kind of consumable. ``tags``: its tags, in place of
        those it has. ``until``: the stop rule; empty for none. ``stop_after``: so many rows may fail; 0 for
        however many. ``name``: of the new campaign; that of the first one if empty. ``visibility``: who sees
        it: lab, group or private. ``dry_run``: only check it. ``propose``: it waits for an approval, whatever
        the policy says. Returns ``campaign``, ``estimate``, ``approval``. Raises NotFound, Refused,
        BadInput."""
        return self._post(
            f"/campaigns/{in_path(campaign)}/clone",
            {
                "by": by,
                "priority": priority,
                "deadline": deadline,
                "runs": runs,
                "lab_time_s": lab_time_s,
                "consumables": consumables,
                "tags": tags,
                "until": until,
                "stop_after": stop_after,
                "name": name,
                "visibility": visibility,
                "dry_run": dry_run,
                "propose": propose,
            },
            request=request or self._ids.new(),
            timeout_s=900.0,
        )

    def archive_campaign(self, campaign: str, by: str, *, undo: bool = False) -> None:
        """Leave a campaign that has ended out of lists. It is left out of lists; nothing of it is deleted.
        ``undo``: let it stand in lists again. Raises NotFound, Refused."""
        self._post(f"/campaigns/{in_path(campaign)}/archive", {"by": by, "undo": undo}, repeat=True)

    def shares(self) -> list[dict[str, Any]]:
        """Who is to have which part of the lab, and who has had which. Returns the accounts."""
        return self._get("/shares")["accounts"]

    def apply_shares(self, text: str, file: str, by: str) -> None:
        """Let weights and quotas be as a shares file says. ``text``: the file. ``file``: what errors call the
        file. Raises Refused, BadInput."""
        self._post("/shares", {"text": text, "name": file, "by": by}, repeat=True)
