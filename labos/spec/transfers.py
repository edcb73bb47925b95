"""The part of a workcell's file about transfers that name no module: the modules and the costs."""

from __future__ import annotations

from collections.abc import Mapping

from labos.core.arguments import list_names
from labos.core.ids import ModuleName, StationName
from labos.core.model import Description, TransferWay
from labos.core.structs import make_from
from labos.errors import SpecError
from labos.spec.findings import Remarks, suggest_name
from labos.spec.models import TransferEntry, WorkcellFile
from labos.spec.source import Path_
from labos.spec.stations import Stations


def list_transfer_ways(
    file: WorkcellFile,
    drivers: Mapping[str, Description],
    stations: Stations,
    remarks: Remarks,
    *,
    foreign: bool,
) -> tuple[TransferWay, ...]:
    """The ways of a file. ``drivers`` are the active modules' descriptions, by module. In another lab's file,
    ways with modules or stations that this workcell does not have are left out, with a warning."""
    reader = _Reader(file, drivers, stations, remarks, foreign)
    found = (reader.read_way(entry, ("transfers", index)) for index, entry in enumerate(file.transfers))
    return tuple(way for way in found if way is not None)


class _Reader:
    def __init__(
        self,
        file: WorkcellFile,
        drivers: Mapping[str, Description],
        stations: Stations,
        remarks: Remarks,
        foreign: bool,
    ) -> None:
        self.file, self.drivers, self.stations = file, drivers, stations
        self.add_finding = remarks.add_warning if foreign else remarks.error
        self.has_fault = False

    def read_way(self, entry: TransferEntry, path: Path_) -> TransferWay | None:
        self.has_fault = False
        self._check_action(entry, path)
        way = make_from(
            TransferWay,
            entry,
            module=ModuleName(f"{self.file.name}/{entry.module}"),
            from_stations=self._read_places(entry.from_, (*path, "from")),
            to_stations=self._read_places(entry.to, (*path, "to")),
        )
        return None if self.has_fault else way

    def _check_action(self, entry: TransferEntry, path: Path_) -> None:
        if entry.module not in self.drivers:
            message = f"No active module is called {entry.module!r}, so it cannot be used for transfers."
            self._add_fault(message, (*path, "module"), suggest_name(entry.module, self.drivers, "module"))
            return
        known = self.drivers[entry.module]
        action = known.action(entry.action)
        if action is None:
            remedy = suggest_name(entry.action, (each.name for each in known.actions), "action")
            message = f"{entry.module} has no action {entry.action!r}, so it cannot be used for transfers."
            self._add_fault(message, (*path, "action"), remedy)
            return
        names = list_names(action)
        for written in (entry.source, entry.target, *entry.args):
            if written not in names:
                remedy = suggest_name(written, (arg.name for arg in action.args), "argument")
                message = f"The action {entry.action!r} of {entry.module} has no argument {written!r}."
                self._add_fault(message, path, remedy)

    def _read_places(self, written: list[str], path: Path_) -> tuple[StationName, ...]:
        found: list[StationName] = []
        for index, place in enumerate(written):
            try:
                found.append(self.stations.find(place))
            except SpecError as error:
                self._add_fault(error.message, (*path, index), error.remedy)
        return tuple(found)

    def _add_fault(self, message: str, path: Path_, remedy: str) -> None:
        self.has_fault = True
        self.add_finding(message, path, remedy)
