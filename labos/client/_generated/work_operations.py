"""The operations of labos/http/routes (runs, campaigns, approvals, signatures, forecasts, planning, finding);
written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from labos.client._calls import Calls


class WorkOperations(Calls):
    """One method for each operation."""

    def runs(self, after: int = 0, *, limit: int = 100, ended: int = 0, before: int = 0) -> dict[str, Any]:
        """List the runs that have not ended, and the last ended ones. A page of the runs that have not ended,
        in the order of their submission. While there are ``more``, ask for the next page with ``after`` =
        ``position``. With ``ended``, also runs that have ended, the latest first; for earlier ones ask with
        ``before`` = ``ended_position``. ``after``: only runs that have not ended and were submitted after
        this position. ``limit``: the largest number of runs that have not ended; 100 if left out. ``ended``:
        also answer this number of ended runs. ``before``: only ended runs that ended before this position.
        Returns ``runs``, ``position``, ``more``, ``ended_position``."""
        return self._get("/runs", locals())

    def _submit_runs(
        self,
        workflow: Mapping[str, Any],
        payloads: Sequence[Mapping[str, Any]],
        user: str,
        *,
        workcell: str = "",
        priority: int = 0,
        experiment: str = "",
        place: Sequence[Mapping[str, Any]] = (),
        propose: bool = False,
        due: str = "",
        keys: Sequence[str] = (),
        files: Sequence[Sequence[str]] = (),
        first: int = 0,
        request: str = "",
    ) -> dict[str, Any]:
        """Queue a run of a workflow for each payload, all of them or none."""
        return self._post("/runs/batch", locals(), once=True)

    def cancel(self, run: str, by: str = "somebody", *, stay: bool = False, why: str = "") -> None:
        """Cancel a run. The run ends as soon as its actions under way have ended. If its workflow has steps
        under ``on_cancel``, they then clear its labware away (the status is ``leaving`` during that time);
        otherwise the labware stays where it is. ``stay``: labware stays where it is, even if the workflow has
        steps under ``on_cancel``. ``why``: a reason or comment for the log. Raises Refused."""
        self._post("/runs/{run}/cancel", locals(), repeat=True)

    def pause(self, run: str, by: str = "somebody", *, why: str = "") -> None:
        """Pause a run: no further step starts. ``why``: a reason or comment for the log. Raises Refused."""
        self._post("/runs/{run}/pause", locals(), repeat=True)

    def resume(self, run: str, by: str = "somebody") -> None:
        """Resume a paused run. Raises Refused."""
        self._post("/runs/{run}/resume", locals(), repeat=True)

    def resume_experiment(self, experiment: str, name: str, user: str = "") -> None:
        """Resume an experiment. The application was started again and continues its experiment. A question
        whether the experiment should be closed, because its application was silent, is withdrawn. ``name``:
        the experiment's name, as it was started. Raises Refused."""
        self._post("/experiments/{experiment}/resume", locals(), as_user=True, repeat=True)

    def end_experiment(self, experiment: str, why: str = "ended", user: str = "") -> None:
        """End an experiment. The application has ended. A repeated request has no further effect. ``why``: a
        comment. Raises Refused."""
        self._post("/experiments/{experiment}/end", locals(), as_user=True, repeat=True)

    def note(
        self,
        experiment: str,
        kind: str,
        name: str,
        facts: Mapping[str, Any] | None = None,
        user: str = "",
        *,
        key: str = "",
    ) -> None:
        """Log a note of the application. ``kind``: ``loop_started``, ``loop_ended``, ``decision``,
        ``compute`` and the like, as events.md says. ``name``: its name. ``facts``: a table of anything.
        ``key``: identifies the call in the application; a second note with the same key is ignored. Raises
        Refused."""
        facts = facts or {}
        self._post("/experiments/{experiment}/notes", locals(), as_user=True)

    def keep_file(self, experiment: str, content: bytes, user: str = "") -> str:
        """Store a file of an experiment. Stores a file of an experiment that has not ended, such as the
        result of a computation. ``/files/{sha256}`` returns it. A repeated request has no further effect.
        ``content``: the file, in base64. Returns the sha256. Raises NotFound."""
        return self._post("/experiments/{experiment}/files", locals(), as_user=True, repeat=True)["sha256"]

    def heartbeat(self, experiment: str, user: str = "") -> None:
        """Report that the application is running. The application is running."""
        self._post("/experiments/{experiment}/heartbeat", locals(), as_user=True, repeat=True)

    def campaigns(self) -> list[dict[str, Any]]:
        """List the campaigns that have not been completed."""
        return self._get("/campaigns", locals())["campaigns"]

    def campaign(self, campaign: str) -> dict[str, Any]:
        """Show the progress and the terms of a campaign that has not been completed. Returns ``id``,
        ``name``, ``user``, ``workflow``, ``workcell``, ``status``, ``why``, ``rows``, ``queued``, ``active``,
        ``completed``, ``failed``, ``cancelled``, ``refused``, ``left``, ``lab_time_s``, ``used``, ``terms``,
        ``visibility``, ``cloned_from``."""
        return self._get("/campaigns/{campaign}", locals())

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
        """Change the terms of a campaign."""
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
        """Submit a copy of a campaign."""
        return self._post("/campaigns/{campaign}/clone", locals(), once=True, timeout_s=900.0)

    def archive_campaign(self, campaign: str, by: str, *, undo: bool = False) -> None:
        """Hide a campaign that has ended from lists. Nothing is deleted. ``undo``: show it in lists again.
        Raises NotFound, Refused."""
        self._post("/campaigns/{campaign}/archive", locals(), repeat=True)

    def shares(self) -> list[dict[str, Any]]:
        """Show each user's share of the lab, and the use so far. Returns the accounts."""
        return self._get("/shares", locals())["accounts"]

    def apply_shares(self, text: str, file: str, by: str) -> None:
        """Apply a shares file with weights and quotas. ``text``: the file. ``file``: the name of the file in
        error messages. Raises Refused, BadInput."""
        self._post("/shares", {"text": text, "name": file, "by": by}, repeat=True)

    def approval_of(self, subject: str) -> dict[str, Any]:
        """Show a submission that waits for an approval, and how it differs from the last approved one.
        Returns ``proposal``, ``differences``."""
        return self._get("/approvals/{subject}", locals())

    def approval_forecast(self, subject: str) -> dict[str, Any]:
        """Forecast a submission that waits for an approval. The forecast assumes that the submission is
        approved now, without changes. This does not approve it. An experiment cannot be forecast, because its
        application decides while it runs. Returns ``forecast``, ``consumables``. Raises Refused."""
        return self._get("/approvals/{subject}/forecast", locals())

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
        return self._get("/policy", locals())

    def apply_policy(self, text: str, file: str, by: str) -> None:
        """Apply a policy file. Submissions that wait already continue to wait. ``text``: the file. ``file``:
        the name of the file in error messages. Raises Refused, BadInput."""
        self._post("/policy", {"text": text, "name": file, "by": by}, repeat=True)

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
        return self._get("/runs/{run}/signatures", locals())["signatures"]

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
        return self._get("/experiments/{experiment}/signatures", locals())["signatures"]

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
        return self._get("/campaigns/{campaign}/signatures", locals())["signatures"]

    def forecast(self) -> dict[str, Any]:
        """Forecast when runs start and end, and when a person is needed. LabOS simulates the lab in virtual
        time with durations from its log. The simulation assumes that nothing fails and nobody refills a
        resource. The ranges are as wide as the errors of earlier forecasts. It covers the first 200 waiting
        runs. Returns ``forecast``, ``drifts``. Raises Refused."""
        return self._get("/forecast", locals())

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
        """Forecast when a run would start and end, without submitting it."""
        payload = payload or {}
        return self._post("/runs/forecast", locals(), repeat=True, timeout_s=180.0)

    def actions(self, module: str) -> dict[str, Any]:
        """List the actions of a module. The actions and their arguments, as a step of a workflow uses them.
        Returns ``module``, ``driver``, ``description``, ``actions``."""
        return self._get("/modules/{module}/actions", locals())

    def suggested_order(self, workcell: str) -> dict[str, Any]:
        """Show the order that a planner suggests for the next steps of a workcell. Steps that have started,
        or whose run has ended, are not in the answer. Returns ``workcell``, ``by``, ``until``, ``steps``,
        ``line``. Raises NotFound."""
        return self._get("/workcells/{workcell}/order", locals())

    def suggest_order(
        self,
        workcell: str,
        steps: Sequence[Mapping[str, Any]],
        until: int,
        position: int = 0,
        line: Sequence[str] = (),
        *,
        by: str,
    ) -> int:
        """Suggest an order for the next steps of a workcell. It replaces the previous suggestion. Ended runs
        are ignored. A suggestion never starts a step that could not start without it. ``steps``: the steps,
        in any order; neither steps nor a line: withdraw the suggestion. ``until``: the time until which it is
        valid (UTC ns). ``position``: the position of the log from which it was computed. ``line``: in place
        of steps, for runs with windows: an order of runs with which the lab's own search for an order begins.
        Returns the steps. Raises NotFound, Refused."""
        return self._post("/workcells/{workcell}/order", locals(), repeat=True)["steps"]

    def _check_run(
        self,
        workflow: Mapping[str, Any],
        user: str = "",
        *,
        payload: Mapping[str, Any] | None = None,
        workcell: str = "",
        priority: int = 0,
        experiment: str = "",
        place: Sequence[Mapping[str, Any]] = (),
        propose: bool = False,
        due: str = "",
    ) -> dict[str, Any]:
        """Check a run of a workflow without submitting it."""
        payload = payload or {}
        return self._post("/runs/check", locals(), repeat=True)

    def find(
        self,
        words: str = "",
        *,
        kind: Sequence[str] = (),
        user: Sequence[str] = (),
        workcell: Sequence[str] = (),
        workflow: Sequence[str] = (),
        experiment: Sequence[str] = (),
        run: Sequence[str] = (),
        status: Sequence[str] = (),
        keyword: Sequence[str] = (),
        since: int = 0,
        until: int = 0,
        limit: int = 20,
        offset: int = 0,
        facets: bool = False,
    ) -> dict[str, Any]:
        """Search experiments, runs, samples, files and results by words. Finds experiments, runs, samples,
        images, files, results and publications by words and filters. Entries whose name holds the words come
        first, then the newest. A separate process keeps the search index; ``behind`` is the number of recent
        events that are not in the index yet. ``words``: words that an entry must all contain (``colo*``:
        words with this beginning); empty: everything. ``kind``: experiment, run, sample, image, file, result
        or publication; may be repeated. ``user``: the owner, by id; may be repeated. ``workcell``: the
        workcell; may be repeated. ``workflow``: a workflow's or application's name; may be repeated.
        ``experiment``: the experiment that it belongs to; may be repeated. ``run``: the run that it belongs
        to; may be repeated. ``status``: the status of runs and experiments; may be repeated. ``keyword``: a
        keyword of a publication, or the quantity of a result; may be repeated. ``since``: only entries from
        this time or later (UTC nanoseconds); 0: everything. ``until``: only entries from before this time
        (UTC nanoseconds); 0: everything. ``limit``: the largest number of entries in the answer; 20 if left
        out. ``offset``: the number of entries to skip. ``facets``: whether to count how many there are of
        each user, workcell and so on. Returns ``entries``, ``total``, ``facets``, ``position``, ``behind``.
        Raises Refused."""
        return self._get("/find", locals())
