"""The calls of a client about the bench and its modules: what people do there, and what they say of it."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from labos.client._calls import Calls
from labos.errors import BadInput

STOP_S = 5.0
"""How long a lab may take to answer that it has stopped its modules."""


class BenchCalls(Calls):
    """Interventions, service of modules, labware and stations, workcells, access, samples."""

    def resolve(self, intervention: str, choice: str, by: str, note: str = "", result: Any = None) -> None:
        """Answer an intervention. ``result`` is what a step that was done has measured, if later
        steps read it."""
        answer = {"choice": choice, "by": by, "note": note, "result": result}
        self._post(f"/interventions/{intervention}", answer)

    def emergency_stop(self, target: str, by: str = "somebody") -> dict[str, Any]:
        """Stop a module, a workcell or everything (``*``) at once, without the log. ``stopped``
        are the modules that say so, ``silent`` the others. This is no safety function."""
        return self._post("/estop", {"target": target, "by": by}, repeat=True, timeout_s=STOP_S)

    def take_out(self, module: str, why: str, by: str, until_ns: int = 0) -> None:
        """Take a module out of service, until it is put back or until a time (UTC ns)."""
        self._post(f"/modules/{module}/out-of-service", {"why": why, "by": by, "until": until_ns})

    def put_back(self, module: str, by: str = "somebody") -> None:
        self._post(f"/modules/{module}/in-service", {"by": by}, repeat=True)

    def trace(self, module: str, by: str = "somebody", *, on: bool = True) -> str:
        """Let a module's node write down every byte on its device's wires, or no more; the file is on the
        computer of the node."""
        return str(self._post(f"/modules/{module}/trace", {"by": by, "on": on}, repeat=True)["file"])

    def place(self, station: str, labware: str, by: str) -> str:
        """Say that labware of a type was put on an empty station; returns its id."""
        body = {"station": station, "labware": labware, "by": by}
        return str(self._post("/stations/place", body)["labware"])

    def load(self, station: str, labware: str, by: str, *, count: int = 1, lot: str = "") -> list[str]:
        """Say that labware of a type was put on a stack, or into free slots; returns the names it
        got: on a stack it has none until it is taken."""
        body = {"station": station, "labware": labware, "by": by, "count": count, "lot": lot}
        return [str(name) for name in self._post("/stations/load", body)["labware"]]

    def unload(self, station: str, by: str, *, labware: str = "", count: int | None = None) -> dict[str, Any]:
        """Say that labware was taken away: one piece by its name, the topmost ``count``, or all.
        ``labware`` of the answer are the names of those that had one, ``nameless`` counts the rest."""
        body = {"station": station, "by": by, "labware": labware, "count": count}
        return self._post("/stations/unload", body)

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
        """Say that more of a resource was put in, as much as there was room for if no ``amount`` is
        named; returns how much. ``unit`` is the resource's own if it is not said; ``expires`` is a
        date, as 2027-05-31; ``instead`` of what was left."""
        pack = {"amount": amount, "unit": unit, "lot": lot, "expires": expires, "instead": instead}
        body = {"resource": resource, "by": by, **pack}
        return float(self._post(f"/modules/{module}/replenish", body)["amount"])

    def declare(
        self, stations: Mapping[str, Sequence[str]], by: str, *, workcell: str = "", empty: bool = False
    ) -> dict[str, list[str]]:
        """Say what stands at stations, bottom to top; with ``empty``, that those nobody has spoken of
        stand empty. All of it or nothing; returns what was declared."""
        told = {name: list(types) for name, types in stations.items()}
        body = {"stations": told, "by": by, "workcell": workcell, "empty": empty}
        found: dict[str, list[str]] = self._post("/stations/declare", body)["declared"]
        return found

    def apply_workcell(
        self,
        text: str,
        file: str,
        by: str,
        *,
        dry_run: bool = False,
        labware: Mapping[str, bytes] | None = None,
        files: Mapping[str, bytes] | None = None,
    ) -> dict[str, Any]:
        """Change a workcell to what the text of its file says; with ``dry_run``, only say what that
        would change and what is in the way. ``labware`` holds the labware files that it names, ``files``
        the others, as tables of drivers: the lab reads nothing else."""
        body = {"text": text, "name": file, "by": by, "dry_run": dry_run}
        for key, contents in (("labware", labware), ("files", files)):
            body[key] = {name: b64encode(content).decode() for name, content in (contents or {}).items()}
        return self._post("/workcells", body, repeat=True)

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
        """Say where a manipulator finds a station, with a ``labware_type`` only when it carries that;
        returns the version of the pose."""
        body = {"station": station, "pose": list(pose), "by": by, "why": why, "labware_type": labware_type}
        return int(self._post(f"/modules/{module}/locations", body, repeat=True)["version"])

    def locations(self, module: str) -> dict[str, Any]:
        """The poses of a module by station, with their versions; 0 is the workcell file's. ``types`` are
        those of labware types, where they differ."""
        found: dict[str, Any] = self._get(f"/modules/{module}/locations")["locations"]
        return found

    def enter(self, workcell: str, by: str, why: str = "", *, park: bool = True) -> list[str]:
        """Ask to reach into a workcell: nothing starts there any more. Returns the runs that park its
        arms; ``state()["lab"]["access"]`` says when it is granted, and of which modules nobody knows
        whether they are at rest (``perhaps_moving``)."""
        body = {"by": by, "why": why, "park": park}
        found: list[str] = self._post(f"/workcells/{workcell}/access", body, repeat=True)["parking"]
        return found

    def leave(self, workcell: str, by: str, changed: Sequence[tuple[str, str]] = (), note: str = "") -> None:
        """Say that everybody is out, and what stands at which station now: ``empty``, labware by its
        id, or a type of labware."""
        told = [{"station": station, "what": what} for station, what in changed]
        self._post(f"/workcells/{workcell}/access/end", {"by": by, "note": note, "changed": told})

    def barcode(self, labware: str, barcode: str, by: str, *, replace: bool = False) -> None:
        """Say which barcode labware bears."""
        body = {"barcode": barcode, "by": by, "replace": replace}
        self._post(f"/labware/{labware}/barcode", body, repeat=True)

    def observe(self, station: str, what: str, by: str) -> dict[str, Any]:
        """Say what stands at a station: ``empty``, a number, labware, a labware type; returns what
        follows: ``found``, ``gone``, ``uncertain``, ``answered``, ``asked``."""
        return self._post("/stations/observe", {"station": station, "what": what, "by": by})

    def round(self) -> dict[str, Any]:
        """What is known of a log that has lost its end (``evidence``, ``discovered``), and every station
        with what is ``recorded`` there, whether it was ``said`` on the round and whether it
        ``must_be_said``; without such a log, there are none. ``not_known`` are doors, lids and the like of
        modules."""
        return self._get("/round")

    def say(
        self,
        by: str,
        stations: Mapping[str, Sequence[str]] | None = None,
        as_recorded: Sequence[str] = (),
        *,
        finish: bool = False,
    ) -> dict[str, Any]:
        """Say on the round what stands at stations, bottom to top, and which are as recorded. Returns what
        was ``said``, what was ``refused`` and why, and what is ``left`` to say; with ``finish`` the question
        about the round is ``answered``, if that is nothing."""
        told = {name: list(contents) for name, contents in (stations or {}).items()}
        body = {"by": by, "stations": told, "as_recorded": list(as_recorded), "finish": finish}
        return self._post("/round", body, repeat=True)

    def give(self, labware: str, to: str, by: str, *, force: bool = False, note: str = "") -> None:
        """Hand labware over to ``user:NAME``, ``experiment:E3`` or ``shared``."""
        body = {"to": to, "by": by, "force": force, "note": note}
        self._post(f"/labware/{labware}/owner", body, repeat=True)

    def load_samples(
        self,
        sheet: str | Path,
        by: str,
        *,
        labware: str = "",
        station: str = "",
        replace: bool = False,
    ) -> dict[str, int]:
        """Say which samples are in the wells of plates, by a CSV file; ``labware`` or ``station``
        names the plate where the sheet does not. Returns how many samples each plate has."""
        path = Path(sheet)
        body = {
            "text": _text_of(path),
            "name": str(path),
            "by": by,
            "labware": labware,
            "station": station,
            "replace": replace,
        }
        found: dict[str, int] = self._post("/samples", body, repeat=True)["plates"]
        return found


def _text_of(path: Path) -> str:
    """A file that a person wrote. Raises BadInput."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise BadInput(f"The file {path} cannot be read: {error.strerror or error}.") from None
    except UnicodeDecodeError:
        raise BadInput(f"The file {path} is not text.", remedy="Save it as CSV in UTF-8.") from None
