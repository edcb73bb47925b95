"""The operations of labos/http/routes/planning.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedPlanning(Calls):
    """One method for each operation."""

    def actions(self, module: str) -> dict[str, Any]:
        """What a module can do. Its actions, with the arguments that a step of a workflow gives them. Returns
        ``module``, ``driver``, ``description``, ``actions``."""
        return self._get(f"/modules/{in_path(module, 2)}/actions")

    def suggested_order(self, workcell: str) -> dict[str, Any]:
        """In which order a planner suggests that the next steps of a workcell start. Of steps that have
        started, or whose run has ended, nothing is said. Returns ``workcell``, ``by``, ``until``, ``steps``.
        Raises NotFound."""
        return self._get(f"/workcells/{in_path(workcell)}/order")

    def suggest_order(
        self, workcell: str, steps: Sequence[Mapping[str, Any]], until: int, position: int = 0, *, by: str
    ) -> int:
        """Suggest in which order the next steps of a workcell start. It replaces what was suggested before.
        Steps of runs that have ended are left out. What is suggested never makes a step start that could not
        start without it. ``steps``: in any order; none: no advice any more. ``until``: until when it counts
        (UTC ns). ``position``: the log's position that it was worked out from. Returns the steps. Raises
        NotFound, Refused."""
        return self._post(
            f"/workcells/{in_path(workcell)}/order",
            {"steps": steps, "until": until, "position": position, "by": by},
            repeat=True,
        )["steps"]

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
        """What a run of a workflow would be, without submitting it. Nothing is submitted, nothing is kept.
        ``workflow``: the workflow, with the files that it names. ``user``: who asks; not read in a lab that
        has users: there it is the user who has signed in. ``payload``: values for the workflow. ``workcell``:
        needed if the lab has several. ``priority``: higher goes first; 0. ``experiment``: the experiment it
        belongs to; it must be the user's. ``place``: labware that was put on the bench for it; recorded with
        the run, or not at all. ``propose``: it waits for an approval, whatever the policy says. ``due``: when
        it should be over: a time, or how long from now (``12h``); empty: never. Returns ``workflow``,
        ``workcell``, ``steps``, ``demand``, ``approval``, ``refusal``, ``warnings``. Raises NotFound,
        Refused, BadInput."""
        return self._post(
            "/runs/check",
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
        )
