"""The operations of labos/http/routes/runs.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedRuns(Calls):
    """One method for each operation."""

    def runs(self, after: int = 0, *, limit: int = 100, ended: int = 0, before: int = 0) -> dict[str, Any]:
        """List the runs that have not ended, and the last ended ones. A page of the runs that have not ended,
        in the order of their submission. While there are ``more``, ask for the next page with ``after`` =
        ``position``. With ``ended``, also runs that have ended, the latest first; for earlier ones ask with
        ``before`` = ``ended_position``. ``after``: only runs that have not ended and were submitted after
        this position. ``limit``: the largest number of runs that have not ended; 100 if left out. ``ended``:
        also answer this number of ended runs. ``before``: only ended runs that ended before this position.
        Returns ``runs``, ``position``, ``more``, ``ended_position``."""
        return self._get("/runs", after=after, limit=limit, ended=ended, before=before)

    def _submit_run(
        self,
        workflow: Mapping[str, Any],
        user: str,
        *,
        payload: Mapping[str, Any] | None = None,
        workcell: str = "",
        priority: int = 0,
        experiment: str = "",
        place: Sequence[Mapping[str, Any]] = (),
        propose: bool = False,
        due: str = "",
        request: str = "",
    ) -> dict[str, Any]:
        """Queue a run of a workflow. ``workflow``: the workflow, with the files that it names. ``user``: the
        user who asks; ignored in a lab that has users, where it is the user who has signed in. ``payload``:
        values for the workflow. ``workcell``: needed if the lab has several. ``priority``: higher goes first;
        0. ``experiment``: the experiment to which the run belongs; it must belong to the same user.
        ``place``: labware that was put on the bench for the run; recorded with the run, or not at all.
        ``propose``: wait for an approval, also if the policy does not require one. ``due``: the time by which
        the run should end: a time, or a duration from now (``12h``); empty: none. Returns ``run``,
        ``warnings``, ``approval``. Raises NotFound, Refused, BadInput."""
        payload = payload or {}
        return self._post("/runs", locals(), once=True)

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
        """Queue a run of a workflow for each payload, all of them or none. The runs are queued in one step:
        all of them, or none. So the first one starts when the lab knows the last one. ``workflow``: the
        workflow, with the files that it names. ``payloads``: values for the workflow, of one run each.
        ``user``: the user who asks; ignored in a lab that has users, where it is the user who has signed in.
        ``workcell``: needed if the lab has several. ``priority``: higher goes first; 0. ``experiment``: the
        experiment to which they belong; it must be the user's. ``place``: labware that was put on the bench
        for them; recorded once with the runs, or not at all. ``propose``: wait for an approval, also if the
        policy does not require one. ``due``: the time by which they should end: a time, or a duration from
        now (``12h``); empty: none. ``keys``: a key for each run; a repeated key is the same run; left out:
        the request's key with ``-0``, ``-1`` …. ``files``: for each run, the names of the workflow's files
        that it has; left out: all of them. ``first``: the number of payloads sent before these; error
        messages count them too. Returns ``runs``, ``warnings``, ``approvals``. Raises NotFound, Refused,
        BadInput."""
        return self._post("/runs/batch", locals(), once=True)

    def _get_run(self, run: str, *, wait: float = 0.0) -> dict[str, Any]:
        """Show a run with its steps, or its end. ``wait``: seconds to wait for its end. Returns ``id``,
        ``workflow``, ``workcell``, ``user``, ``experiment``, ``submitted_at``, ``steps``, ``status``,
        ``started_at``, ``ended_at``, ``why``, ``paused``, ``closing``, ``campaign``, ``busy``, ``due_at``."""
        return self._get(f"/runs/{in_path(run)}", wait=wait)

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

    def _start_experiment(
        self,
        name: str,
        user: str,
        *,
        closing: Mapping[str, Any] | None = None,
        parking: Sequence[str] = (),
        payload: Mapping[str, Any] | None = None,
        workcell: str = "",
        priority: int = 0,
        propose: bool = False,
        request: str = "",
    ) -> dict[str, Any]:
        """Start an experiment. An application starts. From now on it has to send a note or a heartbeat at
        least every 30 s; otherwise LabOS asks a person. A run of the experiment is refused if it would leave
        labware anywhere except at the ``parking`` stations, in storage or in a waste station. ``name``: its
        name. ``user``: the user who asks; ignored in a lab that has users, where it is the user who has
        signed in. ``closing``: the workflow that clears away the labware which the experiment leaves parked.
        ``parking``: stations where the experiment may leave labware between its runs; left out: everywhere.
        ``payload``: values for the closing workflow. ``workcell``: needed if the lab has several.
        ``priority``: of its runs; 0. ``propose``: wait for an approval, also if the policy does not require
        one. Returns ``experiment``, ``approval``. Raises NotFound, Refused, BadInput."""
        payload = payload or {}
        return self._post("/experiments", locals(), once=True)

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
