"""The operations of labos/http/routes/signatures.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedSignatures(Calls):
    """One method for each operation."""

    def sign_run(self, run: str, meaning: str, password: str, *, why: str = "") -> dict[str, Any]:
        """Sign the record of a run that has ended. The signature is an event, and binds to all records of the
        run. Who signs shows the password again, whatever they signed in with. ``meaning``: ``authored``,
        ``responsible``, ``reviewed``, ``approved`` or ``rejected``. ``password``: the password, once more.
        ``why``: a comment, for the log. Returns ``subject``, ``kind``, ``run``, ``by``, ``meaning``, ``why``,
        ``method``, ``at``, ``time``, ``position``, ``runs``, ``records``, ``digest``, ``holds``. Raises
        NotFound, Refused."""
        return self._post(
            f"/runs/{in_path(run)}/signatures",
            {"meaning": meaning, "password": password, "why": why},
            repeat=True,
        )

    def signatures(self, run: str) -> list[dict[str, Any]]:
        """Who has signed the record of a run. In the order of the log. ``holds``: the record of the run is
        the one that was signed. Raises NotFound."""
        return self._get(f"/runs/{in_path(run)}/signatures")["signatures"]

    def sign_experiment(
        self, experiment: str, meaning: str, password: str, *, why: str = ""
    ) -> dict[str, Any]:
        """Sign the record of an experiment that has ended. As for a run. The signature binds to all records
        of the experiment and of all its runs. ``meaning``: ``authored``, ``responsible``, ``reviewed``,
        ``approved`` or ``rejected``. ``password``: the password, once more. ``why``: a comment, for the log.
        Returns ``subject``, ``kind``, ``run``, ``by``, ``meaning``, ``why``, ``method``, ``at``, ``time``,
        ``position``, ``runs``, ``records``, ``digest``, ``holds``. Raises NotFound, Refused."""
        return self._post(
            f"/experiments/{in_path(experiment)}/signatures",
            {"meaning": meaning, "password": password, "why": why},
            repeat=True,
        )

    def experiment_signatures(self, experiment: str) -> list[dict[str, Any]]:
        """Who has signed the record of an experiment. In the order of the log. ``holds``: the records are
        those that were signed. Raises NotFound."""
        return self._get(f"/experiments/{in_path(experiment)}/signatures")["signatures"]

    def sign_campaign(self, campaign: str, meaning: str, password: str, *, why: str = "") -> dict[str, Any]:
        """Sign the record of a campaign that has ended. As for a run. The signature binds to all records of
        the campaign and of all its runs. ``meaning``: ``authored``, ``responsible``, ``reviewed``,
        ``approved`` or ``rejected``. ``password``: the password, once more. ``why``: a comment, for the log.
        Returns ``subject``, ``kind``, ``run``, ``by``, ``meaning``, ``why``, ``method``, ``at``, ``time``,
        ``position``, ``runs``, ``records``, ``digest``, ``holds``. Raises NotFound, Refused."""
        return self._post(
            f"/campaigns/{in_path(campaign)}/signatures",
            {"meaning": meaning, "password": password, "why": why},
            repeat=True,
        )

    def campaign_signatures(self, campaign: str) -> list[dict[str, Any]]:
        """Who has signed the record of a campaign. In the order of the log. ``holds``: the records are those
        that were signed. Raises NotFound."""
        return self._get(f"/campaigns/{in_path(campaign)}/signatures")["signatures"]
