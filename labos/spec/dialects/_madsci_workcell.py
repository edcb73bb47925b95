"""MADSci's nodes, locations and resource templates, as a workcell (MADSci 0.8).

The file is the lab's ``settings.yaml`` (``workcell_nodes: {name: url}``, ``location_locations``,
``resource_default_templates``) with the ``locations.yaml`` beside it, or a workcell manager's definition
(``name, nodes, locations``).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from labos.core.ids import split_written_place
from labos.spec.dialects._madsci_transfers import KEYS, TransferTemplates
from labos.spec.dialects._reader import Reader, is_number
from labos.spec.findings import FindingList
from labos.spec.source import Path_, Place, Source, SourceList, SourceMapping, make_plain, name_field, read

INTERFACES = {"http": "madsci_rest_node", "https": "madsci_rest_node", "sila": "madsci_sila_node"}
LOCATIONS_FILE = "locations.yaml"
"""Read beside the settings if it exists, as MADSci does."""

KINDS = {
    "slot": "nest",
    "stack": "stack",
    "queue": "stack",
    "row": "hotel",
    "grid": "hotel",
    "voxel_grid": "hotel",
    "collection": "hotel",
}
"""Stations by the base type of a location's resource; others are nests."""

_SERVERS = re.compile(r"(lab|event|experiment|resource|data|workcell|location)_\w+")
_BAD = re.compile(r"[^A-Za-z0-9_ ()\-]")


def is_workcell(source: Source) -> bool:
    """Whether the file names MADSci nodes."""
    data = source.data
    if "labos" in data or "modules" in data:
        return False
    return "workcell_nodes" in data or (
        "nodes" in data and data.get("manager_type") in (None, "workcell_manager")
    )


def rewrite_workcell(source: Source, report: FindingList) -> Source:
    """Rewrite a workcell file. Raises SpecError for an unknown form."""
    return _Workcell(source, report).make_form()


class _Workcell:
    def __init__(self, source: Source, report: FindingList) -> None:
        self.reader = Reader(source, report)
        self.source, self.data = source, source.data
        self.modules: dict[str, SourceMapping] = {}
        self.taught: dict[str, SourceMapping] = {}
        self.stations = SourceMapping(source.data.at)
        self.places: dict[str, str] = {}
        """Stations by the names and ids of their locations."""
        self.moved: dict[str, str] = {}

    def make_form(self) -> Source:
        data, at = self.data, self.data.at
        out = SourceMapping(at)
        self._read_name(out)
        for key in ("workcell_manager_description", "workcell_description", "description"):
            if isinstance(data.get(key), str) and "description" not in out:
                out.take(data, key, "description")
        nodes = "workcell_nodes" if "workcell_nodes" in data else "nodes"
        for name, url, path in self.reader.iterate_entries(data[nodes], (nodes,), f"`{nodes}`"):
            self._read_node(name, url, path)
        modules = SourceList(self.source.place((nodes,)))
        for module in self.modules.values():
            modules.put(module, module.at)
        out.put("modules", modules)
        self._read_own_locations()
        self._read_locations_beside()
        out.put("locations", SourceMapping(at, self.taught))
        out.put("stations", self.stations)
        out.put("stock", SourceMapping(at))  # MADSci's locations are empty at first
        ways = TransferTemplates(self.reader, self.modules, self.places).read()
        if ways:
            out.put("transfers", ways, at, at)
        self._ignore_unused(nodes)
        done = self.reader.finish(out)
        done.moved = self.moved
        return done

    def _read_name(self, out: SourceMapping) -> None:
        for key in ("workcell_manager_name", "workcell_name", "manager_name", "name"):
            if isinstance(self.data.get(key), str):
                out.take(self.data, key, "name")
                break
        else:
            self.reader.take_name(out, SourceMapping())
        if _BAD.search(out["name"]):
            out["name"] = _BAD.sub("_", out["name"])
            self.reader.add_warning(
                f"The workcell is called {out['name']!r} here.", (), "Give it another name."
            )

    def _read_node(self, name: str, url: Any, path: Path_) -> None:
        if not isinstance(url, str) or "://" not in url:
            raise self.source.error(
                f"The node {name!r} has no address.",
                path,
                remedy="Write http://host:port or sila://host:port.",
            )
        at = self.source.place(path)
        module, config = SourceMapping(at), SourceMapping(at, {"node_url": url})
        scheme = url.partition("://")[0].lower()
        if scheme not in INTERFACES:
            self.reader.add_warning(
                f"LabOS does not know how to reach {url!r}.", path, "Write http:// or sila://."
            )
        called = _BAD.sub("_", name)
        if called != name:
            self.reader.add_warning(
                f"The node {name!r} is called {called!r} here.", path, "Rename it.", key=True
            )
        module.put("name", called, self.source.place(path, key=True), self.source.place(path, key=True))
        module.put("interface", INTERFACES.get(scheme, scheme))
        module.put("config", config)
        self.moved[name_field(path)] = f"modules[{len(self.modules)}]"
        self.modules[name] = module

    # -- locations ---------------------------------------------------------------------------

    def _read_own_locations(self) -> None:
        written = SourceMapping(self.data.at)
        for key in ("locations", "location_templates", "representation_templates"):
            for name in (f"location_{key}", key):
                if name in self.data and key not in written:
                    written.take(self.data, name, key)
        templates: dict[str, SourceMapping] = {}
        for key in ("resource_default_templates", "default_templates"):
            templates |= self._sort_by_name(self.reader, self.data, key)
        self._add(self.reader, written, templates, None)

    def _read_locations_beside(self) -> None:
        """``locations.yaml``, or the file that the settings name; its own faults name it."""
        name = self.data.get("location_lab_config_file") or LOCATIONS_FILE
        folder = self.source.folder
        if folder is None or not isinstance(name, str):
            return
        path = (folder / name).resolve()
        if not path.is_relative_to(folder.resolve()) or not path.is_file():
            return
        beside = read(Path(self.source.file).parent / name, last_wins=True)
        report = FindingList(beside.file)
        self._add(Reader(beside, report), beside.data, {}, self.data.at)
        self.reader.report.take(report)

    def _add(
        self, reader: Reader, data: SourceMapping, resources: dict[str, SourceMapping], at: Place | None
    ) -> None:
        templates = self._sort_by_name(reader, data, "location_templates")
        ways = self._sort_by_name(reader, data, "representation_templates")
        if data.get("locations") is None:
            return
        key = "location_locations" if "location_locations" in reader.source.data else "locations"
        for index, entry in enumerate(reader.expect_sequence(data["locations"], (key,), "the locations")):
            path = (key, index)
            location = _Location(reader, reader.expect_table(entry, path, "A location"), path)
            location.read(templates, ways, resources)
            self._place(location, at or reader.source.place(path))

    @staticmethod
    def _sort_by_name(reader: Reader, data: SourceMapping, key: str) -> dict[str, SourceMapping]:
        if data.get(key) is None:
            return {}
        rows = reader.expect_sequence(data[key], (key,), "the templates")
        entries = [reader.expect_table(row, (key, n), "A template") for n, row in enumerate(rows)]
        return {str(entry.get("template_name")): entry for entry in entries}

    def _place(self, location: _Location, at: Place) -> None:
        owner, _ = split_written_place(location.name)
        own = location.name.count(".") == 1 and owner in self.modules
        place = location.name if own else f"wc.{location.name.replace('.', '_')}"
        if place in self.stations:
            raise location.reader.source.error(
                f"The location {location.name!r} is listed twice.", location.path, remedy="Remove one."
            )
        station = SourceMapping(at, {"kind": location.kind, "capacity": location.capacity})
        self.places[location.name] = place
        aliases = SourceList(at)
        for alias in (location.name, location.id):
            if alias and alias != place:
                self.places[alias] = place
                aliases.put(alias, at)
        if aliases:
            station.put("aliases", aliases)
        if not location.transfers:
            station.put("transfers", False)
        if location.comment:
            station.put("comment", location.comment)
        self.stations.put(place, station, at, at)
        self.moved[name_field(location.path)] = f"stations.{place}"
        for node, value in location.ways.items():
            if node in self.modules:
                self._teach(node, place, value, at, own=own and node == owner)
                if location.resource:
                    self._configure(node, "resource_ids", place, location.resource, at)
            else:
                location.warn(
                    f"The location {location.name!r} is taught to {node!r}, which is not a node in this file."
                )

    def _teach(self, node: str, place: str, value: Any, at: Place, *, own: bool) -> None:
        """Add a place to a node: joints if it is a list of numbers; any other value goes to the node's
        configuration, as ``representations``."""
        joints = SourceList(at)
        if isinstance(value, list) and value and all(is_number(joint) for joint in value):
            for joint in value:
                joints.put(joint, at)
        elif value is not None:
            self._configure(node, "representations", place, value, at)
        if not own:
            self.taught.setdefault(node, SourceMapping(at)).put(place, joints, at, at)

    def _configure(self, node: str, table: str, place: str, value: Any, at: Place) -> None:
        """Add a place to a table of a node's configuration."""
        config = self.modules[node]["config"]
        if table not in config:
            config.put(table, SourceMapping(at), at, at)
        config[table].put(place, value, at, at)

    def _ignore_unused(self, nodes: str) -> None:
        used = {nodes, "name", "description", "locations", "manager_type", "manager_id", "workcell_id"}
        for key in self.data:
            if key not in (*used, *KEYS) and not _SERVERS.fullmatch(key):
                self.reader.ignore((key,))


class _Location:
    """One location, with its templates as defaults."""

    def __init__(self, reader: Reader, written: SourceMapping, path: Path_) -> None:
        self.reader, self.written, self.path = reader, written, path
        name = written.get("location_name") or written.get("name")
        if not isinstance(name, str) or "/" in name:
            raise reader.source.error("A location has no name.", path, remedy="Write `location_name:`.")
        self.name = name
        self.comment = str(written.get("description") or "")
        self.resource = str(written.get("resource_id") or "")
        self.id = str(written.get("location_id") or "")
        self.transfers = written.get("allow_transfers") is not False
        self.ways: dict[str, Any] = {}
        self.kind, self.capacity = "nest", 1

    def warn(self, message: str) -> None:
        self.reader.add_warning(message, self.path, "Check the name.")

    def read(
        self,
        templates: dict[str, SourceMapping],
        ways: dict[str, SourceMapping],
        resources: dict[str, SourceMapping],
    ) -> None:
        for key in ("representations", "references", "lookup"):
            if key in self.written:
                table = self.reader.expect_table(self.written[key], (*self.path, key), f"`{key}`")
                self.ways |= {node: make_plain(value) for node, value in table.items()}
        resource = self.written.get("resource_template_name")
        template = self._find(templates, self.written.get("template_name"), "location template")
        if template is not None:
            self._bind(template, ways)
            resource = resource or template.get("resource_template_name")
        found = self._find(resources, resource, "resource template")
        self._hold([found.get("base_resource") if found else None, self.written.get("resource_definition")])

    def _find(self, known: dict[str, SourceMapping], name: Any, what: str) -> SourceMapping | None:
        if name is None:
            return None
        if str(name) not in known:
            self.warn(f"The {what} {name!r} is not in this file; {self.name!r} is assumed to be a nest.")
        return known.get(str(name))

    def _bind(self, template: SourceMapping, ways: dict[str, SourceMapping]) -> None:
        """The representation of the location for each node: the defaults of the roles, overridden by the
        written values."""
        bound = self._read_table(self.written, "node_bindings")
        over = self._read_table(self.written, "representation_overrides")
        for role, name in self._read_table(template, "representation_templates").items():
            node = bound.get(role)
            if not isinstance(node, str):
                raise self.reader.source.error(
                    f"The location {self.name!r} names no node for the role {role!r}.",
                    (*self.path, "node_bindings"),
                    remedy=f"Write `{role}: …` below `node_bindings:`.",
                )
            defaults = self._find(ways, name, "representation template") or SourceMapping()
            own = over.get(role)
            self.ways[node] = {
                **make_plain(defaults.get("default_values") or {}),
                **make_plain(own if isinstance(own, SourceMapping) else {}),
            }

    def _read_table(self, written: SourceMapping, key: str) -> SourceMapping:
        return self.reader.expect_table(written.get(key), (*self.path, key), f"`{key}`")

    def _hold(self, resources: list[Any]) -> None:
        for resource in (*resources, self.written.get("resource_template_overrides")):
            if isinstance(resource, SourceMapping):
                self.kind = KINDS.get(str(resource.get("base_type", "")), self.kind)
                if isinstance(resource.get("capacity"), int) and resource["capacity"] >= 1:
                    self.capacity = resource["capacity"]
