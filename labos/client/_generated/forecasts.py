"""The operations of labos/http/routes/forecasts.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from labos.client._calls import Calls


class GeneratedForecasts(Calls):
    """One method for each operation."""

    def forecast(self) -> dict[str, Any]:
        """When runs start and end, and when a person is needed. The lab is carried on in virtual time, with
        the durations that its log has taught: nothing fails, and nobody fills anything up. Ranges are as wide
        as earlier forecasts were off. The first 200 runs that wait are looked at. Returns ``forecast``,
        ``drifts``. Raises Refused."""
        return self._get("/forecast")

    def _forecast_run(
        self,
        workflow: Mapping[str, Any],
        *,
        user: str,
        payload: Mapping[str, Any] | None = None,
        workcell: str = "",
        priority: int = 0,
        experiment: str = "",
        place: Sequence[Mapping[str, Any]] = (),
        propose: bool = False,
        due: str = "",
    ) -> dict[str, Any]:
        """When a run would start and end, without submitting it. Nothing is submitted, nothing is kept. It is
        taken as approved. ``workflow``: the workflow, with the files that it names. ``user``: who asks; not
        read in a lab that has users: there it is the user who has signed in. ``payload``: values for the
        workflow. ``workcell``: needed if the lab has several. ``priority``: higher goes first; 0.
        ``experiment``: the experiment it belongs to; it must be the user's. ``place``: labware that was put
        on the bench for it; recorded with the run, or not at all. ``propose``: it waits for an approval,
        whatever the policy says. ``due``: when it should be over: a time, or how long from now (``12h``);
        empty: never. Returns ``forecast``, ``warnings``. Raises NotFound, Refused, BadInput."""
        return self._post(
            "/runs/forecast",
            {
                "workflow": workflow,
                "user": user,
                "payload": payload or {},
                "workcell": workcell,
                "priority": priority,
                "experiment": experiment,
                "place": place,
                "propose": propose,
                "due": due,
            },
            repeat=True,
            timeout_s=180.0,
        )

    def _forecast_campaign_file(
        self,
        text: str,
        workflow: Mapping[str, Any],
        user: str,
        *,
        name: str = "campaign",
        files: Mapping[str, bytes] | None = None,
        dry_run: bool = False,
        propose: bool = False,
    ) -> dict[str, Any]:
        """What a campaign would need and bring, without submitting it. It is checked row by row; nothing is
        submitted, nothing is kept. It is taken as approved. ``text``: the campaign file. ``workflow``: the
        workflow, with the files that it names. ``user``: who asks; not read in a lab that has users: there it
        is the user who has signed in. ``name``: what errors call the file. ``files``: the table that it
        names, in base64, by the name that it has for it. ``dry_run``: only check it. ``propose``: it waits
        for an approval, whatever the policy says. Returns ``estimate``, ``forecast``. Raises NotFound,
        Refused, BadInput."""
        return self._post(
            "/campaigns/forecast",
            {
                "text": text,
                "workflow": workflow,
                "user": user,
                "name": name,
                "files": files or {},
                "dry_run": dry_run,
                "propose": propose,
            },
            repeat=True,
            timeout_s=900.0,
        )
