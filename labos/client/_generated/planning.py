"""The operations of labos/http/routes/planning.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedPlanning(Calls):
    """One method for each operation."""

    def actions(self, module: str) -> dict[str, Any]:
        """List the actions of a module. The actions and their arguments, as a step of a workflow uses them.
        Returns ``module``, ``driver``, ``description``, ``actions``."""
        return self._get(f"/modules/{in_path(module, 2)}/actions")

    def suggested_order(self, workcell: str) -> dict[str, Any]:
        """Show the order that a planner suggests for the next steps of a workcell. Steps that have started,
        or whose run has ended, are not in the answer. Returns ``workcell``, ``by``, ``until``, ``steps``.
        Raises NotFound."""
        return self._get(f"/workcells/{in_path(workcell)}/order")

    def suggest_order(
        self, workcell: str, steps: Sequence[Mapping[str, Any]], until: int, position: int = 0, *, by: str
    ) -> int:
        """Suggest an order for the next steps of a workcell. It replaces the previous suggestion. Steps of
        ended runs are ignored. A suggestion never starts a step that could not start without it. ``steps``:
        the steps, in any order; none: withdraw the suggestion. ``until``: the time until which it is valid
        (UTC ns). ``position``: the position of the log from which it was computed. Returns the steps. Raises
        NotFound, Refused."""
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
        """Check a run of a workflow without submitting it. Nothing is submitted or stored. ``workflow``: the
        workflow, with the files that it names. ``user``: the user who asks; ignored in a lab that has users,
        where it is the user who has signed in. ``payload``: values for the workflow. ``workcell``: needed if
        the lab has several. ``priority``: higher goes first; 0. ``experiment``: the experiment to which the
        run belongs; it must belong to the same user. ``place``: labware that was put on the bench for the
        run; recorded with the run, or not at all. ``propose``: wait for an approval, also if the policy does
        not require one. ``due``: the time by which the run should end: a time, or a duration from now
        (``12h``); empty: none. Returns ``workflow``, ``workcell``, ``steps``, ``demand``, ``approval``,
        ``refusal``, ``warnings``. Raises NotFound, Refused, BadInput."""
        payload = payload or {}
        return self._post("/runs/check", locals(), repeat=True)
