"""The stations of a workcell: from the drivers' descriptions, with the additions and changes of the file, and
the arms that were taught them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import msgspec

from labos.core.bench import split_item
from labos.core.ids import ModuleName, StationName, local, split_place, split_written_place
from labos.core.model import Description, Station, StationKind, StationSpec
from labos.core.structs import make_from
from labos.errors import SpecError
from labos.spec.findings import Remarks, suggest_name, suggest_similar
from labos.spec.labware import load_packaged_labware
from labos.spec.models import ANY, LabwareType, PoseEntry, ShelfPoses, StationEntry, WorkcellFile
from labos.spec.source import Path_
from labos.spec.stations import Stations, strip_place

WASTE = ("trash", "waste")
WASTE_CAPACITY = 50
CLAIMED = ("nest", "deck")
"""Kinds of station whose labware belongs to the run that holds the module."""


def compile_stations(
    file: WorkcellFile,
    drivers: Mapping[str, Description],
    remarks: Remarks,
    *,
    foreign: bool,
    own: Mapping[str, LabwareType],
) -> Stations:
    """All stations. ``drivers`` are the active modules' descriptions by module, ``own`` the labware types of
    the lab's own files; in a foreign file, places without a description are assumed to be nests."""
    types = {**load_packaged_labware(), **own}
    _warn_of_unknown(file, types, remarks)
    compiler = _StationCompiler(file, drivers, remarks, foreign)
    compiler.describe()
    compiler.add_written()
    compiler.add_shelves()
    compiler.add_locations()
    compiler.reach_hotels()
    compiler.override()
    compiler.fit_grips({name: tuple(kind.grips) for name, kind in types.items() if kind.grips})
    compiler.keep_off_stacks([name for name, kind in sorted(types.items()) if not kind.stackable])
    compiler.fit_out_shelves()
    return compiler.make_index()


def expand_shelves(file: WorkcellFile, remarks: Remarks) -> WorkcellFile:
    """The file with a location for each shelf instead of those for whole hotels."""
    locations: dict[str, dict[str, PoseEntry]] = {}
    for owner, places in file.locations.items():
        known = locations[owner] = {}
        for place, written in places.items():
            path = ("locations", owner, place)
            entry = file.stations.get(place)
            shelves = entry.shelves if entry is not None else None
            if not isinstance(written, ShelfPoses):
                known[place] = written
            elif shelves is None:
                message = f"{place} has no shelves, but {owner} has a pose for its first shelf."
                remarks.error(message, path, f"Give it `shelves:` under `stations: {place}:`, or one pose.")
            elif len(written.first) != len(written.step):
                message = f"The first shelf has {len(written.first)} values, the step {len(written.step)}."
                remarks.error(
                    message, (*path, "step"), "Give the same number: 0 for a value that does not change."
                )
            else:
                known |= {f"{place}.{number}": written.find_pose(number) for number in range(1, shelves + 1)}
    return file.model_copy(update={"locations": locations})


def _warn_of_unknown(file: WorkcellFile, known: Collection[str], remarks: Remarks) -> None:
    """A type without a description can be used, but may be a typing error: a warning is given once, at its
    first place."""
    seen = {*known, ""}
    for kind, path, key in _list_named_types(file):
        if kind not in seen:
            seen.add(kind)
            remedy = "Describe it in a labware file, and name that under `labware:`."
            if meant := suggest_similar(kind, known):
                remedy = f"{meant} Else describe it in a labware file that `labware:` names."
            message = f"Nobody describes the labware type {kind!r}: its wells and grips are not checked."
            remarks.add_warning(message, path, remedy, key=key)


def _list_named_types(file: WorkcellFile) -> Iterator[tuple[str, Path_, bool]]:
    """Each type, its place, and whether it is a key there."""
    for place, entry in file.stations.items():
        for number, kind in enumerate(entry.accepts or ()):
            yield kind, ("stations", place, "accepts", number), False
        for arm, grips in entry.reach.items():
            for kind in grips if isinstance(grips, dict) else ():
                yield kind, ("stations", place, "reach", arm, kind), True
    for arm, places in file.locations.items():
        for place, poses in places.items():
            for kind in poses if isinstance(poses, dict) else ():
                if kind != ANY:
                    yield kind, ("locations", arm, place, kind), True
    for place, counts in (file.stock or {}).items():
        for item in counts:
            for kind in split_item(item):
                yield kind, ("stock", place, item), True


class _StationCompiler:
    def __init__(
        self, file: WorkcellFile, drivers: Mapping[str, Description], remarks: Remarks, foreign: bool
    ) -> None:
        self.file, self.drivers, self.remarks, self.foreign = file, drivers, remarks, foreign
        self.modules: Collection[str] = {entry.name for entry in file.modules}
        self.stations: dict[StationName, StationSpec] = {}

    def make_index(self) -> Stations:
        return Stations(self.file.name, self.stations.values())

    def describe(self) -> None:
        """The stations that the drivers describe."""
        for module, description in self.drivers.items():
            for station in description.stations:
                self._put(self._describe(module, station))

    def add_written(self) -> None:
        """Stations of the file that are in no driver's description."""
        known = self.make_index()
        for place, entry in self.file.stations.items():
            owner, last = split_place(place)
            if known.find_known(place):
                continue
            if owner in self.modules and owner not in self.drivers:
                continue  # the module is not active
            if "/" in place or not owner or not last:
                self.remarks.error(
                    f"{place!r} cannot be a station's name.",
                    ("stations", place),
                    "Write `module.station`, or `wc.station` for one that belongs to no module.",
                    key=True,
                )
            else:
                self._put(self._add(place, entry.kind))

    def add_shelves(self) -> None:
        """The shelves of the file's hotels, with full names only."""
        known = self.make_index()
        for place, entry in self.file.stations.items():
            hotel = known.find_known(place)
            if hotel is None:
                continue  # reported before, or its module is not active
            for number in range(1, (entry.shelves or 0) + 1):
                name = StationName(f"{hotel}.{number}")
                if local(name) in self.file.stations:
                    message = f"{local(name)} is a shelf of {place}, and all its shelves are alike."
                    at = ("stations", local(name))
                    self.remarks.error(message, at, f"Write it for {place}, or make it a separate station.")
                self._put(StationSpec(name=name, kind="hotel", hotel=hotel))

    def reach_hotels(self) -> None:
        """An arm can reach into a hotel if it was taught all its shelves."""
        for hotel, shelves in self._list_hotels().items():
            taught = {arm for shelf in shelves for arm in self.stations[shelf].reach}
            for arm in taught:
                missing = [local(shelf) for shelf in shelves if arm not in self.stations[shelf].reach]
                if missing:
                    some = ", ".join(missing[:3]) + (", …" if len(missing) > 3 else "")
                    self.remarks.error(
                        f"{local(arm)} was taught only some shelves of {local(hotel)}; these are "
                        f"missing: {some}.",
                        ("locations", local(arm)),
                        "Teach all of them, or give the hotel fewer `shelves:`.",
                        key=True,
                    )
            reach = {**self.stations[hotel].reach, **dict.fromkeys(sorted(taught), ())}
            self._put(msgspec.structs.replace(self.stations[hotel], reach=reach))

    def fit_out_shelves(self) -> None:
        """Apply the settings of a hotel to each of its shelves."""
        for hotel, shelves in self._list_hotels().items():
            for shelf in shelves:
                like = self.stations[hotel]
                self._put(msgspec.structs.replace(like, name=shelf, capacity=1, aliases=(), hotel=hotel))

    def _list_hotels(self) -> dict[StationName, list[StationName]]:
        found: dict[StationName, list[StationName]] = {}
        for station in self.stations.values():
            if station.hotel:
                found.setdefault(station.hotel, []).append(station.name)
        return found

    def add_locations(self) -> None:
        """Taught places, and the arms that can reach them."""
        for owner, places in self.file.locations.items():
            if owner not in self.modules and owner != "workcell":
                add_finding = self.remarks.add_warning if self.foreign else self.remarks.error
                add_finding(
                    f"Locations are given for {owner!r}, which is not a module of this workcell.",
                    ("locations", owner),
                    suggest_name(owner, self.modules, "module"),
                    key=True,
                )
            for place in places:
                name = self._locate(owner, place)
                if name in self._list_hotels():
                    self.remarks.error(
                        f"{place} has shelves, but {owner} was taught only one place there.",
                        ("locations", owner, place),
                        f"Write `{{first: […], step: […]}}`, or a location for each: {place}.1, {place}.2, …",
                    )
                elif name and owner in self.drivers:
                    station = self.stations[name]
                    reach = {**station.reach, self._name_module(owner): ()}
                    self._put(msgspec.structs.replace(station, reach=reach))

    def override(self) -> None:
        """Override the drivers' descriptions of stations with those of the file."""
        known = self.make_index()
        for place, entry in self.file.stations.items():
            name = known.find_known(place)
            if name is not None:  # otherwise it was reported before, or its module is not active
                self._put(self._override(place, self.stations[name], entry))

    def fit_grips(self, held: Mapping[str, tuple[str, ...]]) -> None:
        """Limit the grips for labware types at all taught places to those by which the type can be held."""
        for labware, grips in held.items():
            for station in list(self.stations.values()):
                known = station.reach_of.get(labware, {})
                arms = {
                    arm: tuple(grip for grip in grips if not taught or grip in taught)
                    for arm, taught in {**station.reach, **known}.items()
                }
                if arms:
                    # Grips without a match are reported when labware is carried there.
                    arms = {arm: fitting or ("none",) for arm, fitting in arms.items()}
                    self._put(msgspec.structs.replace(station, reach_of={**station.reach_of, labware: arms}))

    def keep_off_stacks(self, kinds: Sequence[str]) -> None:
        """Refuse labware types that are not stackable at stacks."""
        for station in list(self.stations.values()):
            if not kinds or station.kind != "stack" or station.capacity == 1:
                continue
            self._put(msgspec.structs.replace(station, refuses=tuple(kinds)))
            for place, entry in self.file.stations.items():
                wanted = [kind for kind in entry.accepts or () if kind in kinds]
                if wanted and self.make_index().find(place) == station.name:
                    message = (
                        f"Labware of the type {wanted[0]} cannot be stacked, so {place} cannot be a stack."
                    )
                    at = ("stations", place, "accepts", (entry.accepts or []).index(wanted[0]))
                    self.remarks.error(message, at, "Make it a `kind: hotel`, or leave the type out.")

    # -- one station -------------------------------------------------------------------------

    def _describe(self, module: str, station: Station) -> StationSpec:
        name = self._name_module(module)
        return make_from(
            StationSpec,
            station,
            name=StationName(f"{name}.{station.name}"),
            module=name,
            claim=name if station.claim and station.kind in CLAIMED else "",
        )

    def _add(self, place: str, kind: StationKind | None) -> StationSpec:
        owner, last = split_place(place)
        module = self._name_module(owner) if owner in self.drivers else ModuleName("")
        if kind is None:
            kind = "waste" if not module and last.lower() in WASTE else "nest"
        return StationSpec(
            name=StationName(f"{self.file.name}/{place}"),
            kind=kind,
            module=module,
            capacity=WASTE_CAPACITY if kind == "waste" else 1,
            claim=module if kind in CLAIMED else "",
        )

    def _locate(self, owner: str, place: str) -> StationName | None:
        """The station at a taught place; a new one if the file may add it."""
        try:
            return self.make_index().find(place, owner if owner in self.drivers else "")
        except SpecError as error:
            module, _ = split_written_place(place)
            if module in self.modules and module not in self.drivers:
                return None  # the module is not active, or has no driver
            if module not in ("wc", self.file.name):
                path = ("locations", owner, place)
                if not self.foreign:
                    remedy = f"{error.remedy} Or declare it under `stations:`."
                    self.remarks.error(error.message, path, remedy, key=True)
                    return None
                why = (
                    "no driver describes it"
                    if module in self.modules
                    else f"{module!r} is not a module of this workcell"
                )
                message = f"The place {place!r} is assumed to be a nest: {why}."
                self.remarks.add_warning(message, path, error.remedy, key=True)
            station = self._add(strip_place(place) if "." in place else f"wc.{place}", None)
            self._put(station)
            return station.name

    def _override(self, place: str, station: StationSpec, entry: StationEntry) -> StationSpec:
        changes: dict[str, Any] = {}
        for field in ("kind", "capacity", "access", "rotation", "a1", "transfers"):
            value = getattr(entry, field)
            if value is not None:
                changes[field] = value
        if entry.accepts is not None:
            changes["accepts"] = tuple(entry.accepts)
        if entry.zone is not None:
            changes["zone"] = f"{self.file.name}/{entry.zone}"
        if entry.independent:
            if entry.claim:
                self.remarks.error(
                    f"{place!r} cannot both claim its module and be independent of it.",
                    ("stations", place, "independent"),
                    "Leave out one of the two.",
                )
            changes["claim"] = ""
        elif entry.claim is not None:
            changes["claim"] = station.module if entry.claim else ""
        elif entry.kind is not None and entry.kind not in CLAIMED:
            changes["claim"] = ""
        if entry.kind == "waste" and entry.capacity is None:
            changes["capacity"] = WASTE_CAPACITY
        if entry.shelves is not None:
            if entry.kind not in (None, "hotel") or entry.capacity is not None:
                what = "capacity" if entry.kind in (None, "hotel") else "kind"
                message = f"{place!r} has shelves: it is a hotel that holds {entry.shelves}."
                self.remarks.error(message, ("stations", place, what), f"Leave out `{what}:`.")
            changes |= {"kind": "hotel", "capacity": entry.shelves, "claim": ""}
        changes |= self._find_observer(place, entry, changes.get("kind", station.kind))
        reach, reach_of = dict(station.reach), dict(station.reach_of)
        for manipulator, grips in entry.reach.items():
            if manipulator not in self.drivers:
                self.remarks.error(
                    f"{manipulator!r} is not a module of this workcell.",
                    ("stations", place, "reach", manipulator),
                    suggest_name(manipulator, self.drivers, "module"),
                    key=True,
                )
            arm = self._name_module(manipulator)
            if isinstance(grips, list):
                reach[arm] = tuple(grips)
                continue
            reach.setdefault(arm, ())
            for labware, some in grips.items():
                reach_of[labware] = {**reach_of.get(labware, {}), arm: tuple(some)}
        aliases = tuple(dict.fromkeys((*station.aliases, *entry.aliases)))
        return msgspec.structs.replace(station, reach=reach, reach_of=reach_of, aliases=aliases, **changes)

    def _find_observer(self, place: str, entry: StationEntry, kind: StationKind) -> dict[str, Any]:
        """The observer of the station, and when it is asked."""
        if entry.observer is None:
            if entry.verify is not None:
                message = f"{place!r} has a time of observation, but no observer."
                self.remarks.error(
                    message, ("stations", place, "verify"), "Add `observer:`, or leave it out."
                )
            return {}
        at = ("stations", place, "observer")
        if entry.observer not in self.drivers:
            remedy = suggest_name(entry.observer, self.drivers, "module")
            self.remarks.error(f"{entry.observer!r} is not a module of this workcell.", at, remedy)
        if kind == "waste":
            message = f"Labware in the waste {place!r} is off the bench and cannot be observed there."
            self.remarks.error(message, at, "Leave out `observer:`.")
        return {"observer": self._name_module(entry.observer), "verify": entry.verify or "always"}

    def _name_module(self, module: str) -> ModuleName:
        return ModuleName(f"{self.file.name}/{module}")

    def _put(self, station: StationSpec) -> None:
        self.stations[station.name] = station
