"""The operations of labos/http/routes/signatures.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedSignatures(Calls):
    """One method for each operation."""

    def sign_run(self, run: str, meaning: str, password: str, *, why: str = "") -> dict[str, Any]:
        """Sign the record of a run that has ended. The signature is an event and covers all records of the
        run. The user has to give the password again, however they signed in. ``meaning``: ``authored``,
        ``responsible``, ``reviewed``, ``approved`` or ``rejected``. ``password``: the user's password.
        ``why``: a comment, for the log. Returns ``subject``, ``kind``, ``run``, ``by``, ``meaning``, ``why``,
        ``method``, ``at``, ``time``, ``position``, ``runs``, ``records``, ``digest``, ``holds``. Raises
        NotFound, Refused."""
        return self._post("/runs/{run}/signatures", locals(), repeat=True)

    def signatures(self, run: str) -> list[dict[str, Any]]:
        """List the signatures for the record of a run. They are in the order of the log. ``holds``: the
        record is still the one that was signed. Raises NotFound."""
        return self._get(f"/runs/{in_path(run)}/signatures")["signatures"]

    def sign_experiment(
        self, experiment: str, meaning: str, password: str, *, why: str = ""
    ) -> dict[str, Any]:
        """Sign the record of an experiment that has ended. It works as for a run. The signature covers all
        records of the experiment and of all its runs. ``meaning``: ``authored``, ``responsible``,
        ``reviewed``, ``approved`` or ``rejected``. ``password``: the user's password. ``why``: a comment, for
        the log. Returns ``subject``, ``kind``, ``run``, ``by``, ``meaning``, ``why``, ``method``, ``at``,
        ``time``, ``position``, ``runs``, ``records``, ``digest``, ``holds``. Raises NotFound, Refused."""
        return self._post("/experiments/{experiment}/signatures", locals(), repeat=True)

    def experiment_signatures(self, experiment: str) -> list[dict[str, Any]]:
        """List the signatures for the record of an experiment. They are in the order of the log. ``holds``:
        the records are still those that were signed. Raises NotFound."""
        return self._get(f"/experiments/{in_path(experiment)}/signatures")["signatures"]

    def sign_campaign(self, campaign: str, meaning: str, password: str, *, why: str = "") -> dict[str, Any]:
        """Sign the record of a campaign that has ended. It works as for a run. The signature covers all
        records of the campaign and of all its runs. ``meaning``: ``authored``, ``responsible``, ``reviewed``,
        ``approved`` or ``rejected``. ``password``: the user's password. ``why``: a comment, for the log.
        Returns ``subject``, ``kind``, ``run``, ``by``, ``meaning``, ``why``, ``method``, ``at``, ``time``,
        ``position``, ``runs``, ``records``, ``digest``, ``holds``. Raises NotFound, Refused."""
        return self._post("/campaigns/{campaign}/signatures", locals(), repeat=True)

    def campaign_signatures(self, campaign: str) -> list[dict[str, Any]]:
        """List the signatures for the record of a campaign. They are in the order of the log. ``holds``: the
        records are still those that were signed. Raises NotFound."""
        return self._get(f"/campaigns/{in_path(campaign)}/signatures")["signatures"]
