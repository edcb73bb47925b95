"""The operations of labos/http/routes/lab.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from labos.client._calls import Calls


class GeneratedLab(Calls):
    """One method for each operation."""

    def health(self) -> dict[str, Any]:
        """Show whether the kernel works. Probes can use ``/health``, which answers ``{"status": …}`` and
        needs no user. Returns ``status``, ``lab``, ``name``, ``epoch``, ``position``, ``suspended``,
        ``simulated``, ``pace``, ``broken_drivers``, ``log_check``."""
        return self._get("/health")

    def state(self, *, waits: bool = True) -> dict[str, Any]:
        """Show the present state of the lab. Requests at the same time share one answer, which is newer than
        each of them. ``waits``: whether to give the reasons why runs wait, which takes time to compute; true
        if left out. Returns ``lab``, ``position``, ``now``, ``modules``, ``stations``, ``labware``, ``runs``,
        ``queued``, ``interventions``, ``experiments``, ``resources``."""
        return self._get("/state", waits=int(waits))

    def inventory(self) -> dict[str, Any]:
        """Show the resources that are left, and when they run out. Levels and lots of all resources, the
        content of stacks, the room in waste stations, and in ``runs_out`` the first run that would have too
        little. Times are in UTC nanoseconds. Returns ``resources``, ``stacks``, ``runs_looked_at``,
        ``wastes``."""
        return self._get("/inventory")

    def _list_nodes(self, *, module: Sequence[str] = (), check: bool = False) -> list[dict[str, Any]]:
        """Ask the nodes of modules for their present state. The lab asks the modules' nodes over the bus and
        waits at most two seconds. Nothing moves. ``module``: a module; may be repeated; left out: all
        modules. ``check``: each node also reports its identity and what its device observes; nothing moves.
        Returns the modules."""
        return self._get("/nodes", module=module, check=int(check))["modules"]

    def _pause_target(self, target: str, by: str, *, why: str = "", stay: bool = False) -> dict[str, Any]:
        """Pause a run, an experiment, a module, a workcell or the lab. Nothing more starts there except
        resets; actions under way continue to their end. ``target``: a run, an experiment, a module, a
        workcell, or ``lab``. ``why``: for a pause or a cancellation: a reason for the log. ``stay``:
        ``true``: labware of the cancelled runs stays where it is. Returns ``kind``, ``target``, ``runs``,
        ``already``, ``noted``. Raises NotFound, Refused."""
        return self._post("/control/pause", locals(), repeat=True)

    def _resume_target(self, target: str, by: str, *, why: str = "", stay: bool = False) -> dict[str, Any]:
        """Resume a paused run, experiment, module, workcell or lab. ``target``: a run, an experiment, a
        module, a workcell, or ``lab``. ``why``: for a pause or a cancellation: a reason for the log.
        ``stay``: ``true``: labware of the cancelled runs stays where it is. Returns ``kind``, ``target``,
        ``runs``, ``already``, ``noted``. Raises NotFound, Refused."""
        return self._post("/control/resume", locals(), repeat=True)

    def _cancel_target(self, target: str, by: str, *, why: str = "", stay: bool = False) -> dict[str, Any]:
        """Cancel a run, an experiment, or the runs of a module, a workcell or the lab. With a module, the
        started runs that still need it are cancelled; with a workcell or the lab, all runs, also those that
        wait. A cancelled experiment accepts no more runs and closes when its runs have ended. Closing
        workflows continue, because they clear labware away. ``target``: a run, an experiment, a module, a
        workcell, or ``lab``. ``why``: for a pause or a cancellation: a reason for the log. ``stay``:
        ``true``: labware of the cancelled runs stays where it is. Returns ``kind``, ``target``, ``runs``,
        ``already``, ``noted``. Raises NotFound, Refused."""
        return self._post("/control/cancel", locals(), repeat=True)

    def emergency_stop(self, target: str, by: str = "somebody") -> dict[str, Any]:
        """Stop modules at once, in an emergency. The stop does not wait for the log; it is logged afterwards.
        It is not a safety function. ``stopped`` are the modules that confirmed the stop, with the time (UTC
        nanoseconds); ``silent`` are the others. A stopped module is in the state ERROR until a run of its
        action ``reset``, which ``labos reset`` submits. ``target``: a module, a workcell, or ``*`` for
        everything. Returns ``stopped``, ``silent``. Raises NotFound."""
        return self._post("/estop", locals(), repeat=True, timeout_s=5.0)
