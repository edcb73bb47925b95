"""Grips and approaches of an arm at stations, which foreign workflows write in each transfer.

They belong to the station, not to the workflow: then the same workflow runs on a workcell with another arm.
Values on which all workflows of a workcell agree go to the workcell's file; other values stay in the
workflows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal

import msgspec

from labos.core.arguments import list_names
from labos.core.effects import list_moved
from labos.core.ids import ModuleName, StationName, local
from labos.core.model import Description
from labos.spec.about import describe_modules
from labos.spec.models import ModuleEntry, StationEntry, WorkcellFile, WorkflowFile
from labos.spec.stations import Stations
from labos.spec.uses import Use
from labos.spec.workcell import CompiledWorkcell

APPROACH: Literal["approach"] = "approach"
"""The key in an arm's ``config`` for the approaches to stations; the driver reads it."""


What = Literal["grip", "approach"]


class TransferEnd(msgspec.Struct, frozen=True):
    """The value of one argument for one end of a transfer. ``value`` is a grip; for an approach it is the
    taught place on the way. It is None if it is known only when the workflow runs. ``arg`` is the written
    argument."""

    what: What
    arm: ModuleName
    station: StationName
    arg: str
    value: str | None


class TransferReader:
    """Reads the ends of transfers on a workcell."""

    def __init__(self, cell: CompiledWorkcell, descriptions: Mapping[str, Description]) -> None:
        self.cell = cell
        self._stations = Stations(cell.workcell.name, cell.workcell.stations)
        self._offered = describe_modules(cell.workcell, descriptions)
        self._own = {local(each.name) for each in cell.workcell.modules if not each.config.get("about")}

    def find_agreed(self, uses: Iterable[Use]) -> set[TransferEnd]:
        """The ends on which all of these uses agree; of the arguments only the values are compared."""
        values_at: dict[tuple[What, ModuleName, StationName], set[str | None]] = {}
        for use in uses:
            for end in self.list_ends(use.module, use.action, use.args):
                values_at.setdefault((end.what, end.arm, end.station), set()).add(end.value)
        return {
            TransferEnd(what, arm, station, "", value)
            for (what, arm, station), values in values_at.items()
            if len(values) == 1 and (value := next(iter(values))) is not None
        }

    def list_ends(self, module: str, action: str, args: Mapping[str, Any]) -> Iterator[TransferEnd]:
        """The ends of a step's transfer, at stations that the arm was taught."""
        arm = ModuleName(f"{self.cell.workcell.name}/{module}")
        offered = self._offered[arm].action(action) if arm in self._offered else None
        if offered is None:
            return
        known = list_names(offered)
        written = {known[name].name: name for name in args if name in known}
        for effect in list_moved(offered.effects):
            for place, grip in ((effect.source, effect.source_grip), (effect.target, effect.target_grip)):
                end, grip = place.strip("{}"), grip.strip("{}")
                station = self._stations.find_known(args.get(written.get(end, "")), module)
                if station is None or self._stations[station].reach.get(arm) != ():
                    continue
                if given := args.get(written.get(grip, "")):
                    choices = known[grip].choices
                    value = given if isinstance(given, str) and (not choices or given in choices) else None
                    yield TransferEnd("grip", arm, station, written[grip], value)
                through = f"{end}_{APPROACH}"
                if module in self._own and (given := args.get(written.get(through, ""))):
                    way = self._stations.find_known(given, module)
                    yield TransferEnd(APPROACH, arm, station, written[through], local(way) if way else None)


def add_ends(file: WorkcellFile, agreed: Iterable[TransferEnd]) -> tuple[WorkcellFile, dict[str, list[str]]]:
    """A workcell's file with these ends at its stations and arms, and the comments for its fields."""
    stations, comments = dict(file.stations), dict[str, list[str]]()
    approaches: dict[str, dict[str, str]] = {}
    for end in sorted(agreed, key=lambda end: (end.station, end.arm, end.what)):
        place, arm, value = local(end.station), local(end.arm), str(end.value)
        if end.what == APPROACH:
            approaches.setdefault(arm, {})[place] = value
            continue
        entry = stations.get(place, StationEntry())
        stations[place] = entry.model_copy(update={"reach": {**entry.reach, arm: [value]}})
        comment = f"The workflows say that {arm} grips {value} here."
        comments.setdefault(f"stations.{place}", []).append(comment)
    modules = [_add_approaches(entry, approaches.get(entry.name, {})) for entry in file.modules]
    return file.model_copy(update={"stations": stations, "modules": modules}), comments


def _add_approaches(entry: ModuleEntry, approaches: Mapping[str, str]) -> ModuleEntry:
    if not approaches:
        return entry
    config = {**entry.config, APPROACH: {**approaches, **entry.config.get(APPROACH, {})}}
    return entry.model_copy(update={"config": config})


def drop_ends(
    file: WorkflowFile, cells: Sequence[tuple[TransferReader, set[TransferEnd]]]
) -> tuple[WorkflowFile, bool]:
    """A workflow's file without the ends that all of its workcells state themselves, and whether any were
    removed."""
    left = file.model_copy(deep=True)
    has_gone = False
    for _, entry in left.iterate_entries():
        dropped = [
            {
                end.arg
                for end in carrying.list_ends(entry.module, entry.action, entry.args)
                if msgspec.structs.replace(end, arg="") in agreed
            }
            for carrying, agreed in cells
        ]
        for arg in set.intersection(*dropped) if dropped else ():
            del entry.args[arg]
            has_gone = True
    return left, has_gone
