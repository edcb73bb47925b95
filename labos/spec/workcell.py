"""Turns a workcell file and the drivers' descriptions into a ``Workcell``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from labos.core.canonical import digest
from labos.core.ids import ModuleName, StationName, local
from labos.core.model import LABWARE_TYPE, Description, ModuleSpec, Workcell
from labos.errors import SpecError
from labos.spec import rest
from labos.spec.about import GENERIC, BadEffect, extend, make_about, make_description
from labos.spec.bench import DEFAULT_LID, BenchFile, make_default_stock, read_stock
from labos.spec.compile_stations import compile_stations, expand_shelves
from labos.spec.defaults import make_setup, retry_of
from labos.spec.dialects import convert_workcell
from labos.spec.drafting import draft_modules, draft_stations, takes_lids_off
from labos.spec.findings import Finding, FindingList, Remarks, SpecErrors, list_findings, suggest_name
from labos.spec.interfaces import (
    NATIVE,
    PLANNED,
    REACHED,
    explain_unreachable,
    is_configured,
    list_missing_keys,
)
from labos.spec.labware import load_packaged_labware, make_spec, read_own_labware
from labos.spec.models import ANY, Amount, LabwareType, ModuleEntry, ShelfPoses, WorkcellFile
from labos.spec.ros import RosMapping
from labos.spec.serving import list_drivers, list_models, match_driver, suggest_driver
from labos.spec.signals import SignalMapping, SilaMapping
from labos.spec.source import Path_, Source, parse, read
from labos.spec.stations import Stations
from labos.spec.tables import (
    DriverTable,
    check_table,
    explain_broken,
    find_table,
    make_plain_table,
    read_source,
)
from labos.spec.together import read_together
from labos.spec.transfers import list_transfer_ways
from labos.spec.units import in_unit
from labos.spec.uses import Use, read_carriers
from labos.spec.validation import expect_valid, find_first_flaw

MAPPINGS: Mapping[str, tuple[str, Callable[[Any], str]]] = {
    "rest_node": ("rest", rest.find_flaw),
    "epics_node": ("epics", partial(find_first_flaw, SignalMapping)),
    "opcua_node": ("opcua", partial(find_first_flaw, SignalMapping)),
    "ros_node": ("ros", partial(find_first_flaw, RosMapping)),
    "wei_ros_node": ("ros", partial(find_first_flaw, RosMapping)),
    "wei_ros_camera": ("ros", partial(find_first_flaw, RosMapping)),
    "sila_node": ("sila", partial(find_first_flaw, SilaMapping)),
    "madsci_sila_node": ("sila", partial(find_first_flaw, SilaMapping)),
}
"""The interfaces that a table below ``config`` configures: the table's key, and a function that finds its
faults."""


class CompiledWorkcell(msgspec.Struct, frozen=True):
    """A workcell, its initial contents, the warnings of its file, and the file with the drafted parts."""

    workcell: Workcell
    bench: BenchFile
    findings: tuple[Finding, ...]
    file: WorkcellFile

    @property
    def left_out(self) -> dict[str, str]:
        """The modules of the file that are not in the workcell, with the reasons."""
        there = {local(module.name) for module in self.workcell.modules}
        return {
            entry.name: "there is no driver for it"
            if entry.active
            else "it is switched off (`active: false`)"
            for entry in self.file.modules
            if entry.name not in there
        }


def load_workcell(
    path: str | Path, descriptions: Mapping[str, Description], uses: Sequence[Use] | None = None
) -> CompiledWorkcell:
    """Read and compile a workcell file. Raises SpecError or SpecErrors."""
    return compile_workcell(read(path, last_wins=True), descriptions, uses=uses)


def parse_workcell(
    text: str,
    descriptions: Mapping[str, Description],
    file: str = "",
    sent: Mapping[str, bytes] | None = None,
) -> CompiledWorkcell:
    """Compile a workcell given as text. ``sent`` are the files that it names, by these names. Raises
    SpecError or SpecErrors."""
    return compile_workcell(parse(text, file, last_wins=True), descriptions, sent)


def compile_workcell(
    source: Source,
    descriptions: Mapping[str, Description],
    sent: Mapping[str, bytes] | None = None,
    uses: Sequence[Use] | None = None,
) -> CompiledWorkcell:
    """Compile a workcell. The files that it names are searched beside it; if ``sent`` is given, only among
    these, and no disk is read. If ``uses`` by workflows are given, missing parts of another lab's file are
    drafted from them. Raises SpecError or SpecErrors."""
    report = FindingList(source.file)
    form, dialect = convert_workcell(source, report)
    file = expect_valid(WorkcellFile, form, report)
    remarks, foreign = Remarks(form, report), dialect != "labos"
    file = expand_shelves(file, remarks)
    own = read_own_labware(file.labware, remarks, sent)
    drafted = ""
    if foreign and uses is not None:
        uses = [*uses, *read_carriers(form, file)]
        file = _draft(file, form, descriptions, uses, remarks, own.types)
        drafted = digest(file.model_dump_json().encode())
    modules = _Modules(file, descriptions, remarks, foreign, sent)
    stations = compile_stations(file, modules.drivers, remarks, foreign=foreign, own=own.types)
    workcell = Workcell(
        name=file.name,
        digest=modules.make_digest(source, [*own.digests, *([drafted] if drafted else [])]),
        modules=tuple(modules.build(name, stations) for name in modules.drivers),
        stations=tuple(stations.by_name.values()),
        labware=tuple(make_spec(*kind) for kind in sorted({**load_packaged_labware(), **own.types}.items())),
        transfers=list_transfer_ways(file, modules.drivers, stations, remarks, foreign=foreign),
    )
    declared = file.stock
    if declared is not None:
        bench = read_stock(declared, stations, remarks)
    else:
        lid = DEFAULT_LID if foreign and takes_lids_off(uses or (), modules.drivers) else ""
        bench = make_default_stock(workcell, lid, 1 if foreign and uses else 0)
    report.raise_if_failed()
    return CompiledWorkcell(workcell, bench, report.sort_findings(), file)


def _draft(
    file: WorkcellFile,
    form: Source,
    descriptions: Mapping[str, Description],
    uses: Sequence[Use],
    remarks: Remarks,
    own: Mapping[str, LabwareType],
) -> WorkcellFile:
    """Another lab's file with its modules and places drafted from the workflows."""
    aside = Remarks(form, FindingList(form.file))
    file = draft_modules(file, _Modules(file, descriptions, aside, True).drivers, uses, remarks)
    described = _Modules(file, descriptions, aside, True).drivers
    stations = compile_stations(file, described, aside, foreign=True, own=own)
    return draft_stations(file, described, uses, stations, remarks)


def validate_workcell(source: Source | str | Path, descriptions: Mapping[str, Description]) -> list[Finding]:
    """The faults of a workcell file; it never raises because of the file's content."""
    try:
        source = source if isinstance(source, Source) else read(source, last_wins=True)
        return list(compile_workcell(source, descriptions).findings)
    except (SpecError, SpecErrors) as error:
        return list_findings(error)


class _Modules:
    """The modules of a workcell file and the drivers that serve them."""

    def __init__(
        self,
        file: WorkcellFile,
        descriptions: Mapping[str, Description],
        remarks: Remarks,
        foreign: bool,
        sent: Mapping[str, bytes] | None = None,
    ) -> None:
        self.file, self.descriptions, self.remarks, self.foreign = file, descriptions, remarks, foreign
        self.sent = sent
        self.drivers: dict[str, Description] = {}
        self._entries: dict[str, tuple[int, ModuleEntry]] = {}
        self._tables: dict[str, Source] = {}
        for index, entry in enumerate(file.modules):
            if entry.name in self._entries:
                message = f"The module {entry.name!r} is listed twice."
                remarks.error(message, ("modules", index, "name"), "Rename one.")
                continue
            self._entries[entry.name] = (index, entry)
            if entry.active:
                self._check_interface(entry, ("modules", index))
                found = self._describe(entry, ("modules", index))
                if found is not None:
                    self.drivers[entry.name] = found

    def _describe(self, entry: ModuleEntry, path: Path_) -> Description | None:
        """The description from its own ``about:``, otherwise from its driver; with the additions of
        ``extends``."""
        field = "about" if entry.about is not None else "extends"
        if entry.about is not None and (entry.driver or entry.extends is not None):
            other = "driver" if entry.driver else "extends"
            message = "`about:` describes a node that no driver describes."
            remedy = f"Leave out `{other}:`." if entry.driver else "Write it all below `about:`."
            self.remarks.error(message, (*path, "about"), remedy, key=True)
            return None
        found = self._find_description(entry, path) if entry.about is None else None
        try:
            if entry.about is not None:
                reached = entry.interface if entry.interface not in NATIVE else GENERIC
                return make_description(entry.about, reached)
            if found is None or entry.extends is None:
                return found
            return extend(found, entry.extends)
        except BadEffect as error:
            at = (*path, field, "actions", error.action, "effects", error.index)
            self.remarks.error(f"In {error.action!r} {error}.", at, error.remedy)
            return None

    def _find_description(self, entry: ModuleEntry, path: Path_) -> Description | None:
        """The description of its driver, which may depend on a table."""
        driver = self._find_driver(entry, path)
        kind = find_table(driver, self.descriptions) if driver else None
        if kind is not None:
            return self._describe_by_table(kind, entry, path)
        return self.descriptions[driver] if driver else None

    def _describe_by_table(self, kind: DriverTable, entry: ModuleEntry, path: Path_) -> Description | None:
        """The description that follows from the driver's configuration table."""
        at = (*path, "config", kind.key)
        if kind.key not in entry.config:
            self.remarks.error(
                f"The driver {entry.driver or entry.model} needs `{kind.key}`.",
                (*path, "config"),
                f"Write `{kind.key}:` below `config:`, with its table or the name of a file that holds it.",
            )
            return None
        form = self.remarks.source
        try:
            source = read_source(form.data["modules"][path[-1]]["config"][kind.key], form, self.sent)
        except SpecError as error:
            if error.line or error.file:
                self.remarks.report.keep_error(error)
            else:
                self.remarks.error(error.message, at, error.remedy)
            return None
        report = FindingList(source.file)
        table = check_table(kind, source, report)
        self.remarks.report.take(report)
        if table is None:
            return None
        self._tables[entry.name] = source
        return kind.describe(table)

    def make_digest(self, source: Source, labware: Sequence[str]) -> str:
        """The digest of the file, of its tables in separate files, and of ``labware`` files."""
        others = [table.digest for table in self._tables.values() if table.digest != source.digest]
        others += labware
        return digest("\n".join([source.digest, *others]).encode()) if others else source.digest

    def _check_interface(self, entry: ModuleEntry, path: Path_) -> None:
        """An unknown interface is a typing error. A known one without an adapter is no error here: the module
        can be simulated, and its node reports the missing adapter on a real bench."""
        at = (*path, "interface")
        why = explain_unreachable(entry.interface)
        if why and entry.interface not in PLANNED and not self.foreign:
            self.remarks.error(
                why, at, suggest_name(entry.interface, (*REACHED, *PLANNED, "native"), "interface")
            )
        for key in list_missing_keys(entry.interface, entry.config):
            add_finding = self.remarks.add_warning if self.foreign else self.remarks.error
            add_finding(
                f"{entry.interface} needs `{key}`.", (*path, "config"), f"Write `{key}:` below `config:`."
            )
        if entry.interface in MAPPINGS:
            key, find_flaw = MAPPINGS[entry.interface]
            written = entry.config.get(key)
            if written is not None and (wrong := find_flaw(written)):
                self.remarks.error(f"In `{key}:`, {wrong}.", (*path, "config", key), "See docs/adapters.md.")

    def _find_driver(self, entry: ModuleEntry, path: Path_) -> str | None:
        wanted = entry.driver or entry.model
        if wanted and (why := explain_broken(wanted, self.descriptions)):
            key = "driver" if entry.driver else "model"
            self.remarks.error(f"The driver {wanted!r} cannot be used.", (*path, key), why)
            return None
        if entry.driver:
            if entry.driver in self.descriptions:
                return entry.driver
            remedy = suggest_name(entry.driver, self.descriptions, "driver")
            self.remarks.error(f"There is no driver {entry.driver!r}.", (*path, "driver"), remedy)
            return None
        driver = match_driver(entry.model, self.descriptions) if entry.model else None
        if driver is None and self.foreign:
            driver = self._suggest(entry, path)
        if driver:
            serving = list_drivers(entry.model, self.descriptions) if entry.model else []
            if len(serving) > 1:
                add_finding = self.remarks.add_warning if self.foreign else self.remarks.error
                message = f"The model {entry.model!r} has several drivers: {', '.join(serving)}."
                add_finding(message, (*path, "model"), f"Choose one: `driver: {driver}`.")
            return driver
        remedy = "Add `model:` or `driver:`."
        if entry.model:
            remedy = suggest_name(entry.model, list_models(self.descriptions), "model")
        at = (*path, "model") if entry.model else path
        what = f"the model {entry.model!r}" if entry.model else "no model"
        if self.foreign:
            message = f"There is no driver for the module {entry.name!r} ({what}); it is left out."
            if entry.interface in REACHED:
                remedy = f"Or write what `labos node about {entry.interface} ADDRESS` prints below `about:`."
            self.remarks.add_warning(message, at, remedy, assumed="module")
        else:
            self.remarks.error(f"There is no driver for the module {entry.name!r} ({what}).", at, remedy)
        return None

    def _suggest(self, entry: ModuleEntry, path: Path_) -> str | None:
        """The driver to which another lab's file probably refers. Public files name a module by its kind, and
        its model by a name of their own."""
        exact = match_driver(entry.name, self.descriptions)
        if exact:
            return exact
        for key, text in (("model", entry.model), ("name", entry.name)):
            driver = suggest_driver(text, self.descriptions) if text else None
            if driver:
                self.remarks.add_warning(
                    f"The module {entry.name!r} is assumed to have the driver {driver}, because of "
                    f"its {key} {text!r}.",
                    (*path, key),
                    f"Write it down: `driver: {driver}`. Or describe it below `about:`.",
                    assumed="driver",
                )
                return driver
        return None

    def build(self, name: str, stations: Stations) -> ModuleSpec:
        """A module of the compiled workcell."""
        (index, entry), description = self._entries[name], self.drivers[name]
        path = ("modules", index)
        if entry.coordinates is not None and len(entry.coordinates) != 7:
            message = f"Coordinates are seven numbers, here are {len(entry.coordinates)}."
            self.remarks.error(message, (*path, "coordinates"), "Write x, y, z and a quaternion.")
        known = {**description.levels, **dict.fromkeys(description.units, 0.0)}
        self._check_keys(entry.resources, known, (*path, "resources"), "resource")
        self._check_keys(entry.variables, description.variables, (*path, "variables"), "variable")
        self._check_keys(entry.rest or {}, description.variables, (*path, "rest"), "variable")
        if entry.retry is not None and entry.retry.reset and description.action("reset") is None:
            message = f"The module {name!r} has no action 'reset'."
            self.remarks.error(message, (*path, "retry", "reset"), "Leave `reset` out.")
        if entry.setup is not None:
            arguments = {arg.name: True for action in description.actions for arg in action.args}
            if entry.setup.by not in arguments:
                message = f"No action of {name} has the argument {entry.setup.by!r}."
                remedy = suggest_name(entry.setup.by, arguments, "argument")
                self.remarks.error(message, (*path, "setup", "by"), remedy)
        return ModuleSpec(
            name=ModuleName(f"{self.file.name}/{name}"),
            driver=description.driver,
            model=entry.model or next(iter(description.models), ""),
            config=self._make_config(name, entry, description, stations),
            variables={**description.variables, **entry.variables},
            rest=description.rest if entry.rest is None else entry.rest,
            regrip=self._regrip(name, entry, path, stations),
            levels={**description.levels, **self._list_capacities(entry, description, path)},
            zone=f"{self.file.name}/{entry.zone}" if entry.zone else "",
            units=description.units,
            expired=self.file.expired,
            on_error=entry.on_error or "",
            retry=retry_of(entry),
            timeout_s=entry.timeout,
            second_person=entry.second_person,
            setup=make_setup(entry),
            together=read_together(entry, description, stations, path, self.remarks),
        )

    def _list_capacities(self, entry: ModuleEntry, description: Description, path: Path_) -> dict[str, float]:
        """The capacities for consumables in the file, in the units in which the driver counts them."""
        found: dict[str, float] = {}
        for name, written in entry.resources.items():
            value, unit = (written.amount, written.unit) if isinstance(written, Amount) else (written, "")
            try:
                found[name] = in_unit(value, unit, description.units.get(name, ""), name)
            except SpecError as error:
                self.remarks.error(error.message, (*path, "resources", name), error.remedy)
        return found

    def _check_keys(
        self, written: Mapping[str, Any], known: Mapping[str, Any], path: Path_, what: str
    ) -> None:
        for key in written.keys() - known.keys():
            message = f"The module has no {what} {key!r}."
            self.remarks.error(message, (*path, key), suggest_name(key, known, what), key=True)

    def _make_config(
        self, name: str, entry: ModuleEntry, description: Description, stations: Stations
    ) -> dict[str, Any]:
        """The configuration of the module's node: ``config`` as written; ``poses`` of a manipulator by
        station (``poses_of`` labware types, by type and station); and ``interface`` and ``coordinates`` if
        the file has them."""
        config = dict(entry.config)
        ways = config.get("representations")
        if isinstance(ways, dict):
            config["representations"] = {
                _station_of(place, name, stations): way for place, way in ways.items()
            }
        table = self._tables.get(name)
        kind = find_table(description.driver, self.descriptions)
        if table is not None and kind is not None:
            config[kind.key] = make_plain_table(table)
        waste = [local(place.name) for place in stations.by_name.values() if place.kind == "waste"]
        if description.manipulator and waste:
            config.setdefault("waste", waste)
        watched = [
            local(place.name)
            for place in stations.by_name.values()
            if place.watched and local(place.observer) == name and place.module != place.observer
            if not stations.list_shelves(place.name)
        ]
        if watched:
            observes = config.get("observes")
            written = map(str, observes) if isinstance(observes, list | tuple) else ()
            config["observes"] = list(dict.fromkeys([*written, *watched]))
        poses, poses_of = self._list_poses(name, description, stations)
        settings: dict[str, Any] = {"config": config, "poses": poses}
        if poses_of:
            settings["poses_of"] = poses_of
        if is_configured(entry.interface, entry.config):
            settings["interface"] = entry.interface
        if table is not None:
            settings["offers"] = make_about(description)
        if entry.about is not None:
            settings["about"] = entry.about.model_dump(exclude_defaults=True)
        if entry.extends is not None:
            settings["extends"] = entry.extends.model_dump(exclude_defaults=True)
        if entry.coordinates is not None:
            settings["coordinates"] = entry.coordinates
        return settings

    def _list_poses(
        self, name: str, description: Description, stations: Stations
    ) -> tuple[dict[str, list[float]], dict[str, dict[str, list[float]]]]:
        """The module's taught locations by the stations' own names; and those for single labware types."""
        poses: dict[str, list[float]] = {}
        poses_of: dict[str, dict[str, list[float]]] = {}
        for place, written in self.file.locations.get(name, {}).items():
            station = _station_of(place, name, stations)
            if isinstance(written, list):
                poses[station] = written
                continue
            if isinstance(written, ShelfPoses):
                continue  # its shelves are listed separately, or it has none, which was reported
            self._check_types(name, place, written, description)
            poses[station] = written.get(ANY, [])
            for kind, joints in written.items():
                if kind != ANY:
                    poses_of.setdefault(kind, {})[station] = joints
        return poses, poses_of

    def _check_types(
        self, name: str, place: str, written: Mapping[str, list[float]], description: Description
    ) -> None:
        """Check poses by labware type: the module has to receive the type of its labware, and there has to be
        a pose for all other types."""
        at = ("locations", name, place)
        if ANY not in written:
            message = f"{name} has no pose for {place} with labware of other types."
            self.remarks.error(message, at, f"Add `{ANY}:` with the pose for all other labware.", key=True)
        if not any(arg.name == LABWARE_TYPE for action in description.actions for arg in action.args):
            message = f"The driver of {name} has one pose for all labware."
            self.remarks.error(message, at, "Write one list of numbers.", key=True)

    def _regrip(self, name: str, entry: ModuleEntry, path: Path_, stations: Stations) -> StationName:
        """The station where the arm changes its grip: as written, otherwise its own station ``regrip``."""
        if not entry.regrip:
            own = StationName(f"{self.file.name}/{name}.regrip")
            return own if own in stations else StationName("")
        try:
            return stations.find(entry.regrip, name)
        except SpecError as error:
            self.remarks.error(error.message, (*path, "regrip"), error.remedy)
            return StationName("")


def _station_of(place: str, module: str, stations: Stations) -> str:
    """The name that steps use for a station of the file; other names are not changed."""
    found = stations.find_known(place, module)
    return place if found is None else local(found)
