"""The operations of labos/http/routes/modules.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedModules(Calls):
    """One method for each operation."""

    def take_out(self, module: str, why: str, by: str, until_ns: int = 0) -> None:
        """Take a module out of service. Actions under way continue to their end; nothing more starts there.
        ``why``: the reason. ``until_ns``: the time at which it is in service again (UTC nanoseconds); 0: when
        a person puts it back. Raises Refused."""
        self._post(
            "/modules/{module}/out-of-service", {"module": module, "why": why, "by": by, "until": until_ns}
        )

    def put_back(self, module: str, by: str = "somebody") -> None:
        """Put a module back in service. Raises Refused."""
        self._post("/modules/{module}/in-service", locals(), repeat=True)

    def trace(self, module: str, by: str = "somebody", *, on: bool = True) -> str:
        """Start or stop the transcript of a device's links. The module's node records every byte on the links
        to its device, or stops doing so ([links](../links.md)). ``on``: true or left out: start a transcript
        in a new file; false: stop it. Returns the file. Raises Refused."""
        return self._post("/modules/{module}/trace", locals(), repeat=True)["file"]

    def replenish(
        self,
        module: str,
        resource: str,
        by: str,
        *,
        amount: float = 0.0,
        unit: str = "",
        lot: str = "",
        expires: str = "",
        instead: bool = False,
    ) -> float:
        """Report that a resource was refilled. An amount larger than the free room is refused. ``resource``:
        which resource of the module. ``amount``: in the unit of the resource; if left out, as much as there
        is room for. ``unit``: the unit of the amount, such as ``mL``; the unit of the resource if left out.
        ``lot``: the lot of the new pack. ``expires``: the expiry date, such as ``2027-05-31``. ``instead``:
        the rest of the old packs was taken out; ``false`` if left out. Returns the amount. Raises Refused."""
        return self._post("/modules/{module}/replenish", locals())["amount"]

    def locations(self, module: str) -> dict[str, dict[str, Any]]:
        """Show the poses of a manipulator by station. Version 0 is the pose of the workcell file. Poses for
        particular labware types are under ``types``."""
        return self._get(f"/modules/{in_path(module, 2)}/locations")["locations"]

    def teach(
        self,
        module: str,
        station: str,
        pose: Sequence[float],
        by: str,
        why: str = "",
        *,
        labware_type: str = "",
    ) -> int:
        """Teach a manipulator the pose for a station. The node restarts with the new pose. ``station``: the
        station. ``pose``: the numbers of the pose, as many as in the present pose. ``why``: a comment for the
        log. ``labware_type``: the pose is only for labware of this type; the station needs a pose for all
        types first. Returns the version. Raises Refused."""
        return self._post("/modules/{module}/locations", locals(), repeat=True)["version"]

    def calibrate(
        self,
        module: str,
        by: str,
        *,
        what: str = "",
        certificate: str = "",
        report: bytes = b"",
        until: str = "",
        why: str = "",
    ) -> dict[str, Any]:
        """Record a calibration of a module. A later calibration of the same ``what`` replaces it. No run
        waits for a calibration, and none stops because a calibration has expired. ``/files/{sha256}`` returns
        the report. ``what``: the calibrated part or quantity, such as ``volume``; empty for the whole module.
        ``certificate``: the certificate's number. ``report``: the report, in base64; kept with the lab's
        files. ``until``: the last day on which it is valid, such as ``2027-01-01`` (UTC). ``why``: a comment
        for the log. Returns ``module``, ``what``, ``certificate``, ``file``, ``until``. Raises Refused."""
        return self._post("/modules/{module}/calibrations", locals(), once=True)

    def _change_workcell(
        self,
        text: str,
        by: str,
        *,
        name: str = "workcell",
        dry_run: bool = False,
        labware: Mapping[str, bytes] | None = None,
        files: Mapping[str, bytes] | None = None,
    ) -> dict[str, Any]:
        """Apply a workcell file. The answer has the differences (``modules``, ``stations``, ``poses``,
        ``labware``), the changed fields of each module (``details``), the ``blockers``, the warnings about
        its files (``findings``), and whether it was ``applied``. The request reads no file from the lab's
        disk. A module that names files, programs or secrets of its node's computer
        ([workcell](workcell.md#files-programs-and-secrets)) is refused unless the lab has the same module
        already. ``text``: the file. ``name``: the name of the file in error messages. ``dry_run``: only
        answer what would change. ``labware``: the labware files that it names, in base64, by the names that
        it uses. ``files``: the other files that it names: tables of drivers (``plc: hatch.yaml``). Returns
        ``workcell``, ``applied``, ``modules``, ``stations``, ``poses``, ``labware``, ``blockers``,
        ``details``, ``findings``, ``transfers``. Raises Refused, BadInput."""
        labware = labware or {}
        files = files or {}
        return self._post("/workcells", locals(), repeat=True)

    def enter(self, workcell: str, by: str, why: str = "", *, park: bool = True) -> list[str]:
        """Request access to a workcell. Nothing more starts there. ``lab.access`` in the state shows when
        access is ``granted``, and which modules may still be moving because the outcome of their action is
        unknown (``perhaps_moving``). ``why``: what for. ``park``: false: arms stay where they are. Returns
        the parking. Raises Refused."""
        return self._post("/workcells/{workcell}/access", locals(), repeat=True)["parking"]

    def _end_workcell_access(
        self, workcell: str, by: str, *, note: str = "", changed: Sequence[Mapping[str, Any]] = ()
    ) -> None:
        """End the access to a workcell. No person works in the workcell any more, and it continues. ``note``:
        a comment for the log. ``changed``: the stations that were changed, and what stands there now. Raises
        Refused."""
        self._post("/workcells/{workcell}/access/end", locals())
