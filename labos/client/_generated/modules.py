"""The operations of labos/http/routes/modules.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedModules(Calls):
    """One method for each operation."""

    def take_out(self, module: str, why: str, by: str, until_ns: int = 0) -> None:
        """Take a module out of service. What runs there ends, nothing more starts. ``why``: the reason.
        ``until_ns``: when it is back by itself (UTC nanoseconds); 0: when somebody puts it back. Raises
        Refused."""
        self._post(f"/modules/{in_path(module, 2)}/out-of-service", {"why": why, "by": by, "until": until_ns})

    def put_back(self, module: str, by: str = "somebody") -> None:
        """Put a module back in service. Raises Refused."""
        self._post(f"/modules/{in_path(module, 2)}/in-service", {"by": by}, repeat=True)

    def trace(self, module: str, by: str = "somebody", *, on: bool = True) -> str:
        """Begin or end the transcript of a device's wires. The module's running node writes down every byte
        on its device's wires, or no more ([links](../links.md)). ``on``: left out or true: from now on, in a
        new file; false: no more. Returns the file. Raises Refused."""
        return self._post(f"/modules/{in_path(module, 2)}/trace", {"by": by, "on": on}, repeat=True)["file"]

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
        """Say that more of a resource was put in. More than there is room for is refused. ``resource``: which
        resource of the module. ``amount``: in the resource's unit; as much as there is room for if not said.
        ``unit``: of the amount, as ``mL``; the resource's own if left out. ``lot``: the lot of the new pack.
        ``expires``: the date until which it is good, as ``2027-05-31``. ``instead``: what was left of the old
        packs was taken out; ``false`` if left out. Returns the amount. Raises Refused."""
        return self._post(
            f"/modules/{in_path(module, 2)}/replenish",
            {
                "resource": resource,
                "by": by,
                "amount": amount,
                "unit": unit,
                "lot": lot,
                "expires": expires,
                "instead": instead,
            },
        )["amount"]

    def locations(self, module: str) -> dict[str, dict[str, Any]]:
        """Where a manipulator finds stations. By station; version 0 is the workcell file's. Labware types
        with poses of their own stand below ``types``."""
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
        """Teach a manipulator a station. Its node is started again with the new pose. ``station``: the
        station. ``pose``: numbers, as many as before. ``why``: a word for the log. ``labware_type``: the pose
        is for labware of this type only; the station needs one of its own first. Returns the version. Raises
        Refused."""
        return self._post(
            f"/modules/{in_path(module, 2)}/locations",
            {"station": station, "pose": pose, "by": by, "why": why, "labware_type": labware_type},
            repeat=True,
        )["version"]

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
        """Record a calibration of a module. A later one of the same ``what`` takes its place, and corrects
        it. No run waits for a calibration, and none stops because one has expired. The report is had again at
        ``/files/{sha256}``. ``what``: what of the module was calibrated, as ``volume``; empty for all of it.
        ``certificate``: the certificate's number. ``report``: the report, in base64; kept with the lab's
        files. ``until``: the last day on which it is valid, as ``2027-01-01`` (UTC). ``why``: a word for the
        log. Returns ``module``, ``what``, ``certificate``, ``file``, ``until``. Raises Refused."""
        return self._post(
            f"/modules/{in_path(module, 2)}/calibrations",
            {
                "by": by,
                "what": what,
                "certificate": certificate,
                "report": report,
                "until": until,
                "why": why,
            },
            request=self._ids.new(),
        )

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
        """Change a workcell to what its file says. Answers what differs (``modules``, ``stations``,
        ``poses``, ``labware``), by module the fields that change (``details``), the ``blockers``, the
        warnings of its files (``findings``), and whether it was ``applied``. Nothing is read from the lab's
        disk because of it. A module that names files, programs or secrets of its node's computer
        ([workcell](workcell.md#files-programs-and-secrets)) is refused unless the lab has it like that.
        ``text``: the file. ``name``: what errors shall call the file. ``dry_run``: only say what would
        change. ``labware``: the labware files that it names, in base64, by the names that it has for them.
        ``files``: the other files that it names: tables of drivers (``plc: hatch.yaml``). Returns
        ``workcell``, ``applied``, ``modules``, ``stations``, ``poses``, ``labware``, ``blockers``,
        ``details``, ``findings``, ``transfers``. Raises Refused, BadInput."""
        return self._post(
            "/workcells",
            {
                "text": text,
                "by": by,
                "name": name,
                "dry_run": dry_run,
                "labware": labware or {},
                "files": files or {},
            },
            repeat=True,
        )

    def enter(self, workcell: str, by: str, why: str = "", *, park: bool = True) -> list[str]:
        """Ask to reach into a workcell. Nothing more starts there. ``lab.access`` in the state says when it
        is ``granted``, and of which modules nobody knows whether they are at rest (``perhaps_moving``).
        ``why``: what for. ``park``: false: arms stay where they are. Returns the parking. Raises Refused."""
        return self._post(
            f"/workcells/{in_path(workcell)}/access", {"by": by, "why": why, "park": park}, repeat=True
        )["parking"]

    def _end_workcell_access(
        self, workcell: str, by: str, *, note: str = "", changed: Sequence[Mapping[str, Any]] = ()
    ) -> None:
        """Say that everybody is out of a workcell. Everybody is out; the workcell goes on. ``note``: a word
        for the log. ``changed``: what stands at which station now. Raises Refused."""
        self._post(f"/workcells/{in_path(workcell)}/access/end", {"by": by, "note": note, "changed": changed})
