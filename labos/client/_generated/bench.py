"""The operations of labos/http/routes/bench.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedBench(Calls):
    """One method for each operation."""

    def resolve(self, intervention: str, choice: str, by: str, note: str = "", result: Any = None) -> None:
        """Answer a question. ``choice``: the name of one of its choices. ``note``: a word about it.
        ``result``: what a step that was done has measured; required if later steps read it. Raises
        Refused."""
        self._post(
            f"/interventions/{in_path(intervention)}",
            {"choice": choice, "by": by, "note": note, "result": result},
        )

    def place(self, station: str, labware: str, by: str) -> str:
        """Say that labware was put on an empty station. ``station``: the station. ``labware``: its type.
        Returns the labware. Raises NotFound, Refused."""
        return self._post("/stations/place", {"station": station, "labware": labware, "by": by})["labware"]

    def load(self, station: str, labware: str, by: str, *, count: int = 1, lot: str = "") -> list[str]:
        """Say that labware was loaded. On top of a stack, or into free slots. What the station does not
        accept or has no room for is refused. ``station``: the station. ``labware``: its type. ``count``: how
        many pieces; 1 if not said. ``lot``: their lot, which each piece keeps as its variable ``lot``.
        Returns the labware. Raises NotFound, Refused."""
        return self._post(
            "/stations/load", {"station": station, "labware": labware, "by": by, "count": count, "lot": lot}
        )["labware"]

    def unload(self, station: str, by: str, *, labware: str = "", count: int | None = None) -> dict[str, Any]:
        """Say that labware was taken away. It has left the bench. What a run or an experiment that has not
        ended owns is refused. ``station``: the station. ``labware``: one piece, by its id or barcode.
        ``count``: or so many from the top; everything if neither is said. Returns ``labware``, ``nameless``.
        Raises NotFound, Refused."""
        return self._post(
            "/stations/unload", {"station": station, "by": by, "labware": labware, "count": count}
        )

    def observe(self, station: str, what: str, by: str) -> dict[str, Any]:
        """Say what stands at a station. What was uncertain is narrowed down; what contradicts the log is
        asked. Refused while something is carried to or from there. ``station``: the station. ``what``:
        ``empty``, a number, labware by its id or barcode, a labware type; left out: something. Returns
        ``station``, ``found``, ``gone``, ``uncertain``, ``answered``, ``asked``. Raises NotFound, Refused."""
        return self._post("/stations/observe", {"station": station, "what": what, "by": by})

    def declare(
        self,
        stations: Mapping[str, Sequence[str]] | None,
        by: str,
        *,
        workcell: str = "",
        empty: bool = False,
    ) -> dict[str, list[str]]:
        """Declare what stands at stations. Bottom to top; all of it is declared, or nothing. ``stations``:
        types of labware by station. ``workcell``: whose stations ``empty`` means, if the lab has several.
        ``empty``: stations that nobody has spoken of stand empty. Returns the declared. Raises NotFound,
        Refused."""
        return self._post(
            "/stations/declare", {"stations": stations or {}, "by": by, "workcell": workcell, "empty": empty}
        )["declared"]

    def round(self) -> dict[str, Any]:
        """What has to be said of the bench after the log lost its end. What is known of a log that has lost
        its end, and what has to be said of the bench before anything starts; without such a log, there is
        nothing to say. Returns ``intervention``, ``ended``, ``known``, ``evidence``, ``discovered``,
        ``not_known``, ``stations``."""
        return self._get("/round")

    def say(
        self,
        by: str,
        stations: Mapping[str, Sequence[str]] | None = None,
        as_recorded: Sequence[str] = (),
        *,
        finish: bool = False,
    ) -> dict[str, Any]:
        """Say on the round what stands where. Each station is taken or refused for itself. Labware by its id,
        or by its type where the log does not know it, with its lid (``P7+P8``, ``plate96+lid96``); of a waste
        the number counts. When nothing is left, the intervention is answered with ``checked``. ``stations``:
        what stands at stations, bottom to top: ids of labware, or types where the log knows none.
        ``as_recorded``: stations that are as recorded. ``finish``: ``true``: answer the question about the
        round if nothing is left. Returns ``said``, ``refused``, ``left``, ``answered``, ``why_not``."""
        return self._post(
            "/round",
            {"by": by, "stations": stations or {}, "as_recorded": as_recorded, "finish": finish},
            repeat=True,
        )

    def barcode(self, labware: str, barcode: str, by: str, *, replace: bool = False) -> None:
        """Say which barcode labware bears. Refused if other labware on the bench bears it. ``barcode``: what
        its label says. ``replace``: take the place of another barcode: its label was changed. Raises
        Refused."""
        self._post(
            f"/labware/{in_path(labware)}/barcode",
            {"barcode": barcode, "by": by, "replace": replace},
            repeat=True,
        )

    def give(self, labware: str, to: str, by: str, *, force: bool = False, note: str = "") -> None:
        """Hand labware over. Refused while a run uses it, while it is carried or worked on, and if it is not
        ``by``'s. ``to``: ``user:NAME``, ``experiment:E3`` or ``shared``. ``force``: as an operator: it is
        somebody else's. ``note``: a word about it; needed with ``force``. Raises Refused."""
        self._post(
            f"/labware/{in_path(labware)}/owner",
            {"to": to, "by": by, "force": force, "note": note},
            repeat=True,
        )

    def _register_sheet(
        self,
        text: str,
        by: str,
        *,
        name: str = "sheet",
        labware: str = "",
        station: str = "",
        replace: bool = False,
    ) -> dict[str, int]:
        """Say which samples are in the wells of plates. A faulty sheet is refused as a whole, with the places
        of all faults. ``text``: the sheet, CSV. ``name``: what errors call the sheet. ``labware``: the plate,
        where the sheet does not say. ``station``: or where it stands. ``replace``: take the place of an
        earlier sheet. Returns the plates. Raises NotFound, Refused, BadInput."""
        return self._post(
            "/samples",
            {
                "text": text,
                "by": by,
                "name": name,
                "labware": labware,
                "station": station,
                "replace": replace,
            },
            repeat=True,
        )["plates"]
