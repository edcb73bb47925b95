"""The operations of labos/http/routes/runs.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedRuns(Calls):
    """One method for each operation."""

    def runs(self, after: int = 0, *, limit: int = 100, ended: int = 0, before: int = 0) -> dict[str, Any]:
        """Runs that are alive, and the last that have ended. Runs that are alive in the order of their
        submission, a page of them: ask again with ``after`` = ``position`` while there are ``more``. With
        ``ended``, first those that ended last; earlier ones with ``before`` = ``ended_position``. ``after``:
        only runs that are alive and were submitted behind this position. ``limit``: so many runs that are
        alive; 100 if left out. ``ended``: adds the last so many that have ended. ``before``: of those that
        have ended, only what ended before this position. Returns ``runs``, ``position``, ``more``,
        ``ended_position``."""
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
        """Queue a run of a workflow. ``workflow``: the workflow, with the files that it names. ``user``: who
        asks; not read in a lab that has users: there it is the user who has signed in. ``payload``: values
        for the workflow. ``workcell``: needed if the lab has several. ``priority``: higher goes first; 0.
        ``experiment``: the experiment it belongs to; it must be the user's. ``place``: labware that was put
        on the bench for it; recorded with the run, or not at all. ``propose``: it waits for an approval,
        whatever the policy says. ``due``: when it should be over: a time, or how long from now (``12h``);
        empty: never. Returns ``run``, ``warnings``, ``approval``. Raises NotFound, Refused, BadInput."""
        return self._post(
            "/runs",
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
            request=request or self._ids.new(),
        )

    def _get_run(self, run: str, *, wait: float = 0.0) -> dict[str, Any]:
        """A run with its steps, or its end. ``wait``: seconds to wait for its end. Returns ``id``,
        ``workflow``, ``workcell``, ``user``, ``experiment``, ``submitted_at``, ``steps``, ``status``,
        ``started_at``, ``ended_at``, ``why``, ``paused``, ``closing``, ``campaign``, ``busy``, ``due_at``."""
        return self._get(f"/runs/{in_path(run)}", wait=wait)

    def cancel(self, run: str, by: str = "somebody", *, stay: bool = False, why: str = "") -> None:
        """Cancel a run. It ends when what is in flight has ended. Its labware goes the way out that its
        workflow has under ``on_cancel`` (the run is ``leaving`` meanwhile), else it stays where it is.
        ``stay``: labware stays where it is, even if there is a way out. ``why``: a word about it for the log.
        Raises Refused."""
        self._post(f"/runs/{in_path(run)}/cancel", {"by": by, "stay": stay, "why": why}, repeat=True)

    def pause(self, run: str, by: str = "somebody", *, why: str = "") -> None:
        """Start no more steps of a run. ``why``: a word about it for the log. Raises Refused."""
        self._post(f"/runs/{in_path(run)}/pause", {"by": by, "why": why}, repeat=True)

    def resume(self, run: str, by: str = "somebody") -> None:
        """Go on with a run that is paused. Raises Refused."""
        self._post(f"/runs/{in_path(run)}/resume", {"by": by}, repeat=True)

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
        """Begin an experiment. An application begins. It must be heard of every 30 s from now on (a note, or
        a heartbeat), else a person is asked. A run of it that would leave labware elsewhere than at its
        ``parking`` stations, in storage or in a waste is refused. ``name``: its name. ``user``: who asks; not
        read in a lab that has users: there it is the user who has signed in. ``closing``: a workflow as for a
        run, that clears away what the experiment leaves parked. ``parking``: stations where it may leave
        labware between its runs; left out: anywhere. ``payload``: values for the closing workflow.
        ``workcell``: needed if the lab has several. ``priority``: of its runs; 0. ``propose``: it waits for
        an approval, whatever the policy says. Returns ``experiment``, ``approval``. Raises NotFound, Refused,
        BadInput."""
        return self._post(
            "/experiments",
            {
                "name": name,
                "user": user,
                "closing": closing,
                "parking": parking,
                "payload": payload or {},
                "workcell": workcell,
                "priority": priority,
                "propose": propose,
            },
            request=request or self._ids.new(),
        )

    def resume_experiment(self, experiment: str, name: str, user: str = "") -> None:
        """Go on with an experiment. The application was started again and goes on with its experiment. The
        question whether a silent one is to be closed answers itself. ``name``: the experiment's name, as it
        was started. Raises Refused."""
        self._post(f"/experiments/{in_path(experiment)}/resume", {"name": name}, user=user, repeat=True)

    def end_experiment(self, experiment: str, why: str = "ended", user: str = "") -> None:
        """End an experiment. The application is over. Twice is once. ``why``: a word about it. Raises
        Refused."""
        self._post(f"/experiments/{in_path(experiment)}/end", {"why": why}, user=user, repeat=True)

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
        """Log something of the application's own. ``kind``: ``loop_started``, ``loop_ended``, ``decision``,
        ``compute`` and the like, as events.md says. ``name``: its name. ``facts``: a table of anything.
        ``key``: which call of the application it is; the same one twice is noted once. Raises Refused."""
        self._post(
            f"/experiments/{in_path(experiment)}/notes",
            {"kind": kind, "name": name, "facts": facts or {}, "key": key},
            user=user,
        )

    def keep_file(self, experiment: str, content: bytes, user: str = "") -> str:
        """Keep a file of an experiment. Keep a file of an experiment that has not ended, such as the result
        of a computation. It is had again at ``/files/{sha256}``. Twice is once. ``content``: the file, in
        base64. Returns the sha256. Raises NotFound."""
        return self._post(
            f"/experiments/{in_path(experiment)}/files", {"content": content}, user=user, repeat=True
        )["sha256"]

    def heartbeat(self, experiment: str, user: str = "") -> None:
        """Say that the application lives. The application lives."""
        self._post(f"/experiments/{in_path(experiment)}/heartbeat", {}, user=user, repeat=True)
