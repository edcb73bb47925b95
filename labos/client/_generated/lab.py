"""The operations of labos/http/routes/lab.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from labos.client._calls import Calls


class GeneratedLab(Calls):
    """One method for each operation."""

    def health(self) -> dict[str, Any]:
        """Whether the kernel works. For probes there is ``/health``: it answers ``{"status": …}`` and needs
        no user. Returns ``status``, ``lab``, ``name``, ``epoch``, ``position``, ``suspended``, ``simulated``,
        ``pace``, ``broken_drivers``, ``log_check``."""
        return self._get("/health")

    def state(self, *, waits: bool = True) -> dict[str, Any]:
        """Everything that is alive. Those who ask at the same time get one answer, which is newer than their
        questions. ``waits``: whether to say why runs wait, which takes time to work out; true if left out.
        Returns ``lab``, ``position``, ``now``, ``modules``, ``stations``, ``labware``, ``runs``, ``queued``,
        ``interventions``, ``experiments``, ``resources``."""
        return self._get("/state", waits=int(waits))

    def inventory(self) -> dict[str, Any]:
        """What is left, and what runs out when. Levels and lots of all resources, what the stacks hold, the
        room in wastes, and in ``runs_out`` the first run that would find too little. Times in UTC
        nanoseconds. Returns ``resources``, ``stacks``, ``runs_looked_at``, ``wastes``."""
        return self._get("/inventory")

    def _list_nodes(self, *, module: Sequence[str] = (), check: bool = False) -> list[dict[str, Any]]:
        """What the nodes of modules answer now. Asks the modules' nodes over the bus, now, for two seconds at
        most. Nothing moves. ``module``: a module; may be repeated; without it all are asked. ``check``: each
        also says who it is and what its device sees; nothing moves. Returns the modules."""
        return self._get("/nodes", module=module, check=int(check))["modules"]

    def _pause_target(self, target: str, by: str, *, why: str = "", stay: bool = False) -> dict[str, Any]:
        """Pause a run, an experiment, a module, a workcell or the lab. Of what is paused nothing more is
        started but resets; what is in flight goes on to its end. ``target``: a run, an experiment, a module,
        a workcell, or ``lab``. ``why``: of a pause: a word for the log. ``stay``: ``true``: labware of what
        is cancelled stays where it is. Returns ``kind``, ``target``, ``runs``, ``already``, ``noted``. Raises
        NotFound, Refused."""
        return self._post(
            "/control/pause", {"target": target, "by": by, "why": why, "stay": stay}, repeat=True
        )

    def _resume_target(self, target: str, by: str, *, why: str = "", stay: bool = False) -> dict[str, Any]:
        """Resume what is paused. ``target``: a run, an experiment, a module, a workcell, or ``lab``. ``why``:
        of a pause: a word for the log. ``stay``: ``true``: labware of what is cancelled stays where it is.
        Returns ``kind``, ``target``, ``runs``, ``already``, ``noted``. Raises NotFound, Refused."""
        return self._post(
            "/control/resume", {"target": target, "by": by, "why": why, "stay": stay}, repeat=True
        )

    def _cancel_target(self, target: str, by: str, *, why: str = "", stay: bool = False) -> dict[str, Any]:
        """Cancel a run, an experiment, or the runs of a module, a workcell or the lab. Of a module, those
        runs are cancelled that are under way and still need it; of a workcell or the lab, all runs, those
        that wait too. An experiment that is cancelled takes no more runs, and closes when those that it has
        have ended. Closing workflows go on: they clear away. ``target``: a run, an experiment, a module, a
        workcell, or ``lab``. ``why``: of a pause: a word for the log. ``stay``: ``true``: labware of what is
        cancelled stays where it is. Returns ``kind``, ``target``, ``runs``, ``already``, ``noted``. Raises
        NotFound, Refused."""
        return self._post(
            "/control/cancel", {"target": target, "by": by, "why": why, "stay": stay}, repeat=True
        )

    def emergency_stop(self, target: str, by: str = "somebody") -> dict[str, Any]:
        """Stop modules at once, in an emergency. In an emergency: without the log, which is told afterwards.
        This is no safety function. ``stopped`` are the modules that say that they stopped, and when (UTC
        nanoseconds), ``silent`` the others. A stopped module is brought out of its error by a run of its
        action ``reset``, as ``labos reset`` makes one. ``target``: a module, a workcell, or ``*`` for
        everything. Returns ``stopped``, ``silent``. Raises NotFound."""
        return self._post("/estop", {"target": target, "by": by}, repeat=True, timeout_s=5.0)
