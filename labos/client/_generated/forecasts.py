"""The operations of labos/http/routes/forecasts.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from labos.client._calls import Calls


class GeneratedForecasts(Calls):
    """One method for each operation."""

    def forecast(self) -> dict[str, Any]:
        """Forecast when runs start and end, and when a person is needed. LabOS simulates the lab in virtual
        time with durations from its log. The simulation assumes that nothing fails and nobody refills a
        resource. The ranges are as wide as the errors of earlier forecasts. It covers the first 200 waiting
        runs. Returns ``forecast``, ``drifts``. Raises Refused."""
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
        """Forecast when a run would start and end, without submitting it. Nothing is submitted or stored. The
        run counts as approved. ``workflow``: the workflow, with the files that it names. ``user``: the user
        who asks; ignored in a lab that has users, where it is the user who has signed in. ``payload``: values
        for the workflow. ``workcell``: needed if the lab has several. ``priority``: higher goes first; 0.
        ``experiment``: the experiment to which the run belongs; it must belong to the same user. ``place``:
        labware that was put on the bench for the run; recorded with the run, or not at all. ``propose``: wait
        for an approval, also if the policy does not require one. ``due``: the time by which the run should
        end: a time, or a duration from now (``12h``); empty: none. Returns ``forecast``, ``warnings``. Raises
        NotFound, Refused, BadInput."""
        payload = payload or {}
        return self._post("/runs/forecast", locals(), repeat=True, timeout_s=180.0)

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
        """Forecast a campaign and its needs, without submitting it. The campaign is checked row by row.
        Nothing is submitted or stored. It counts as approved. ``text``: the campaign file. ``workflow``: the
        workflow, with the files that it names. ``user``: the user who asks; ignored in a lab that has users,
        where it is the user who has signed in. ``name``: the name of the file in error messages. ``files``:
        the table file of the campaign, in base64, by the name that the campaign file uses. ``dry_run``: only
        check it. ``propose``: wait for an approval, also if the policy does not require one. Returns
        ``estimate``, ``forecast``. Raises NotFound, Refused, BadInput."""
        files = files or {}
        return self._post("/campaigns/forecast", locals(), repeat=True, timeout_s=900.0)
