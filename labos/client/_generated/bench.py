"""The operations of labos/http/routes/bench.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from labos.client._calls import Calls


class GeneratedBench(Calls):
    """One method for each operation."""

    def resolve(self, intervention: str, choice: str, by: str, note: str = "", result: Any = None) -> None:
        """Answer a question. ``choice``: the name of one of its answers. ``note``: a comment. ``result``: the
        measured result of the completed step; required if later steps read it. Raises Refused."""
        self._post("/interventions/{intervention}", locals())

    def place(self, station: str, labware: str, by: str) -> str:
        """Report that labware was put on an empty station. ``station``: the station. ``labware``: its type.
        Returns the labware. Raises NotFound, Refused."""
        return self._post("/stations/place", locals())["labware"]

    def load(self, station: str, labware: str, by: str, *, count: int = 1, lot: str = "") -> list[str]:
        """Report that labware was loaded. The labware is on top of a stack, or in free slots. It is refused
        if the station does not accept it or has no room. ``station``: the station. ``labware``: its type.
        ``count``: the number of pieces; 1 if left out. ``lot``: their lot, which each piece keeps as its
        variable ``lot``. Returns the labware. Raises NotFound, Refused."""
        return self._post("/stations/load", locals())["labware"]

    def unload(self, station: str, by: str, *, labware: str = "", count: int | None = None) -> dict[str, Any]:
        """Report that labware was taken away. The labware has left the bench. It is refused for labware of a
        run or an experiment that has not ended. ``station``: the station. ``labware``: one piece, by its id
        or barcode. ``count``: or this number of pieces from the top; everything if neither is given. Returns
        ``labware``, ``nameless``. Raises NotFound, Refused."""
        return self._post("/stations/unload", locals())

    def observe(self, station: str, what: str, by: str) -> dict[str, Any]:
        """Report what stands at a station. The report narrows down uncertain places. If it contradicts the
        log, LabOS asks a question. It is refused while labware is being moved to or from the station.
        ``station``: the station. ``what``: ``empty``, a number, labware by its id or barcode, or a labware
        type; left out: something. Returns ``station``, ``found``, ``gone``, ``uncertain``, ``answered``,
        ``asked``. Raises NotFound, Refused."""
        return self._post("/stations/observe", locals())

    def declare(
        self,
        stations: Mapping[str, Sequence[str]] | None,
        by: str,
        *,
        workcell: str = "",
        empty: bool = False,
    ) -> dict[str, list[str]]:
        """Declare what stands at stations. The labware is listed from bottom to top. Either all stations are
        declared, or none. ``stations``: types of labware by station. ``workcell``: the workcell for
        ``empty``, if the lab has several. ``empty``: all stations that were not reported are empty. Returns
        the declared. Raises NotFound, Refused."""
        stations = stations or {}
        return self._post("/stations/declare", locals())["declared"]

    def round(self) -> dict[str, Any]:
        """Show what has to be reported of the bench after the log lost its end. The evidence that the log has
        lost its end, and the stations that have to be reported before anything starts. If the log is
        complete, the answer is empty. Returns ``intervention``, ``ended``, ``known``, ``evidence``,
        ``discovered``, ``not_known``, ``stations``."""
        return self._get("/round")

    def say(
        self,
        by: str,
        stations: Mapping[str, Sequence[str]] | None = None,
        as_recorded: Sequence[str] = (),
        *,
        finish: bool = False,
    ) -> dict[str, Any]:
        """Report what stands at stations after the log lost its end. Each station is accepted or refused by
        itself. Labware is named by its id, or by its type if the log does not have it, with its lid
        (``P7+P8``, ``plate96+lid96``). For a waste station only the number matters. When no station is left,
        the intervention is answered with ``checked``. ``stations``: the labware at each station, from bottom
        to top: ids, or types if the log has no id. ``as_recorded``: stations that are as recorded.
        ``finish``: ``true``: answer the intervention if no station is left. Returns ``said``, ``refused``,
        ``left``, ``answered``, ``why_not``."""
        stations = stations or {}
        return self._post("/round", locals(), repeat=True)

    def barcode(self, labware: str, barcode: str, by: str, *, replace: bool = False) -> None:
        """Record the barcode of labware. It is refused if other labware on the bench has this barcode.
        ``barcode``: the text of the barcode. ``replace``: replace another barcode, because the label was
        changed. Raises Refused."""
        self._post("/labware/{labware}/barcode", locals(), repeat=True)

    def give(self, labware: str, to: str, by: str, *, force: bool = False, note: str = "") -> None:
        """Give labware to another owner. It is refused while a run uses the labware, while it is being moved
        or processed, and if it does not belong to ``by``. ``to``: ``user:NAME``, ``experiment:E3`` or
        ``shared``. ``force``: for operators: the labware belongs to somebody else. ``note``: a reason or
        comment; required with ``force``. Raises Refused."""
        self._post("/labware/{labware}/owner", locals(), repeat=True)

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
        """Register the samples in the wells of plates. A sheet with faults is refused completely; the answer
        lists the places of all faults. ``text``: the sheet, CSV. ``name``: the name of the sheet in error
        messages. ``labware``: the plate, if the sheet does not name it. ``station``: or where it stands.
        ``replace``: replace an earlier sheet. Returns the plates. Raises NotFound, Refused, BadInput."""
        return self._post("/samples", locals(), repeat=True)["plates"]
