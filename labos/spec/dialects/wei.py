"""The dialect of the paper's appendix (SI A.1–A.3) and of its relatives, rpl_wei 0.x and WEI 0.7.

Workcell: ``name, config, modules[name, model, interface|type, config, workcell_coordinates,
positions, active], locations{manipulator: {place: joints}}``. Workflow: ``name, metadata,
modules, flowdef[name, module, action|command, args, files, comment|comments]``.
"""

from __future__ import annotations

import re
from pathlib import PurePath
from typing import Any

from labos.spec.findings import Report
from labos.spec.source import Path_, Row, Source, Table, field_name

WORKCELL_KEYS = {"name", "config", "modules", "locations"}
MODULE_KEYS = {"name", "model", "interface", "config", "active"}
PLACEHOLDER = "foo"
"""Public files give this argument to actions that take none."""

STEP_KEYS = {"name", "module", "action", "args", "comment"}


class _Reader:
    """One file on its way into LabOS' form."""

    def __init__(self, source: Source, report: Report) -> None:
        self.source, self.report = source, report

    def ignored(self, path: Path_, why: str = "is not used by LabOS") -> None:
        self.report.warning(
            f"The key {path[-1]!r} {why}.",
            self.source.place(path, key=True),
            field=field_name(path),
            remedy="It is ignored; remove it if you can.",
        )

    def table(self, value: Any, path: Path_, what: str) -> Table:
        """The value as a table; nothing written counts as an empty one."""
        if isinstance(value, Table):
            return value
        if value is None:
            return Table(self.source.place(path))
        raise self.source.error(
            f"{what} must be a table of keys and values.", path, remedy="Write `key: value`."
        )

    def row(self, key: str, what: str) -> Row:
        value = self.source.data.get(key)
        if isinstance(value, Row):
            return value
        problem = "is missing" if key not in self.source.data else "must be a list"
        raise self.source.error(
            f"`{key}` {problem}.", (key,), remedy=f"Write {what} below it, each with a dash."
        )

    def name(self, out: Table, metadata: Table) -> None:
        """The name stands at the root, in the metadata, or is the file's."""
        if isinstance(self.source.data.get("name"), str):
            out.take(self.source.data, "name")
        elif isinstance(metadata.get("name"), str):
            out.take(metadata, "name")
        else:
            out.put(
                "name", PurePath(self.source.file).stem or "unnamed", self.source.data.at, self.source.data.at
            )

    def done(self, out: Table) -> Source:
        return Source(self.source.file, out, self.source.digest, self.source.folder)


def workcell(source: Source, report: Report) -> Source:
    """Rewrite a workcell file. Raises SpecError where its shape is not understood."""
    reader = _Reader(source, report)
    data = source.data
    out = Table(data.at)
    config = reader.table(data.get("config"), ("config",), "`config`")
    reader.name(out, Table())
    out.put("config", config, *_places(data, "config"))
    locations = _locations(reader)
    modules = Row(source.place(("modules",)))
    for index, entry in enumerate(reader.row("modules", "the modules")):
        path = ("modules", index)
        module = reader.table(entry, path, "A module")
        modules.put(_module(reader, module, path, locations), source.place(path))
    out.put("modules", modules, *_places(data, "modules"))
    out.put("locations", locations, *_places(data, "locations"))
    for key in data.keys() - WORKCELL_KEYS:
        reader.ignored((key,))
    return reader.done(out)


def _module(reader: _Reader, module: Table, path: Path_, locations: Table) -> Table:
    out = Table(module.at)
    for key, value in module.items():
        at = (*path, key)
        if value is None:
            continue
        if key in MODULE_KEYS:
            out.take(module, key)
        elif key == "type" and "interface" not in module:
            out.take(module, key, "interface")
        elif key in ("workcell_coordinates", "location", "coordinates"):
            _coordinates(reader, out, module, key, at)
        elif key == "positions":
            _positions(reader, module, at, locations)
        elif key in ("comment", "comments", "description"):
            out.take(module, key, "comment")
        else:
            reader.ignored(at)
    return out


def _coordinates(reader: _Reader, out: Table, module: Table, key: str, path: Path_) -> None:
    value = module[key]
    if isinstance(value, list) and len(value) == 7:
        out.take(module, key, "coordinates")
        return
    count = f"{len(value)} numbers" if isinstance(value, list) else repr(value)
    reader.report.warning(
        f"Coordinates are x, y, z and a quaternion, seven numbers; here are {count}.",
        reader.source.place(path),
        field=field_name(path),
        remedy="They are ignored; write seven numbers.",
    )


def _positions(reader: _Reader, module: Table, path: Path_, locations: Table) -> None:
    """``positions`` name a module's places without saying whose joints they are."""
    places = reader.table(module["positions"], path, "`positions`")
    owner = locations.get("workcell")
    if owner is None:
        owner = Table(places.at)
        locations.put("workcell", owner, places.at, places.at)
    for name in places:
        place = f"{module.get('name')}.{name}"
        at = places.keys_at[name]
        if place not in owner and f"{module.get('name')}" != "None":
            owner.put(place, Row(at), at, at)


def _locations(reader: _Reader) -> Table:
    source = reader.source
    written = reader.table(source.data.get("locations"), ("locations",), "`locations`")
    out = Table(written.at)
    for owner, value in written.items():
        path = ("locations", owner)
        kept = Table(source.place(path))
        for place, joints in reader.table(value, path, "A manipulator's locations").items():
            if isinstance(joints, list) and all(_is_number(joint) for joint in joints):
                kept.take(value, place)
            else:
                reader.ignored((*path, place), "holds no list of numbers")
        out.put(owner, kept, *_places(written, owner))
    return out


def workflow(source: Source, report: Report) -> Source:
    """Rewrite a workflow file. Raises SpecError where its shape is not understood."""
    reader = _Reader(source, report)
    data = source.data
    out = Table(data.at)
    metadata = reader.table(data.get("metadata"), ("metadata",), "`metadata`")
    reader.name(out, metadata)
    about = Table(metadata.at)
    for key in metadata:
        about.take(metadata, key)
    for key in ("author", "version", "info", "description"):
        if key in data:
            about.take(data, key)
    out.put("metadata", about, *_places(data, "metadata"))
    if isinstance(data.get("workcell"), str):
        out.take(data, "workcell")
    if data.get("modules") is not None:
        out.put("modules", _module_names(reader), *_places(data, "modules"))
    parameters = _parameters(reader)
    if parameters:
        out.put("parameters", parameters, *_places(data, "parameters"))
    steps = Row(source.place(("flowdef",)))
    for index, entry in enumerate(reader.row("flowdef", "the steps")):
        path = ("flowdef", index)
        steps.put(
            _step(reader, reader.table(entry, path, "A step"), path, set(parameters)), source.place(path)
        )
    out.put("steps", steps, *_places(data, "flowdef"))
    known = {"name", "metadata", "modules", "flowdef", "workcell", "parameters"}
    for key in data.keys() - known - {"author", "version", "info", "description"}:
        reader.ignored((key,))
    form = reader.done(out)
    form.written_as = {"steps": "flowdef"}
    return form


def _module_names(reader: _Reader) -> Row:
    written = reader.row("modules", "the modules")
    names = Row(written.at)
    for index, entry in enumerate(written):
        path = ("modules", index)
        if isinstance(entry, str):
            names.put(entry, reader.source.place(path))
        elif isinstance(entry, Table) and isinstance(entry.get("name"), str):
            names.put(entry["name"], reader.source.place((*path, "name")))
        else:
            raise reader.source.error("A module has no name.", path, remedy="Write `- name: …`.")
    return names


def _parameters(reader: _Reader) -> Table:
    """WEI 0.7: ``parameters: [{name, default}]``."""
    value = reader.source.data.get("parameters")
    out = Table(reader.source.place(("parameters",)))
    if value is None:
        return out
    for index, entry in enumerate(reader.row("parameters", "the parameters")):
        path = ("parameters", index)
        entry = reader.table(entry, path, "A parameter")
        if not isinstance(entry.get("name"), str):
            raise reader.source.error("A parameter has no name.", path, remedy="Write `- name: …`.")
        parameter = Table(entry.at)
        if "default" in entry:
            parameter.take(entry, "default")
        else:
            parameter.put("required", True, entry.at, entry.at)
        out.put(entry["name"], parameter, entry.at, entry.at)
    return out


def _step(reader: _Reader, step: Table, path: Path_, parameters: set[str]) -> Table:
    out = Table(step.at)
    arguments = Table(reader.source.place((*path, "args")))
    if not arguments.at.line:
        arguments.at = step.at
    for key, value in step.items():
        at = (*path, key)
        if key in ("args", "files"):
            written = reader.table(value, at, f"`{key}`")
            for name, item in written.items():
                if name == PLACEHOLDER:
                    reader.ignored((*at, name), "is a placeholder")
                    continue
                _put_argument(arguments, written, name, item, parameters)
        elif value is None:
            continue
        elif key in STEP_KEYS:
            out.take(step, key)
        elif key == "command" and "action" not in step:
            out.take(step, key, "action")
        elif key == "comments":
            out.take(step, key, "comment")
        elif key == "checks":
            reader.ignored(at, "names checks that LabOS makes itself")
        else:
            reader.ignored(at)
    if "name" not in out and "action" in out:
        out.take(out, "action", "name")
    if "comment" in out and not isinstance(out["comment"], str):
        out["comment"] = str(out["comment"])
    out.put("args", arguments, *_places(step, "args"))
    return out


def _put_argument(arguments: Table, written: Table, name: str, value: Any, parameters: set[str]) -> None:
    """Take an argument over; WEI's ``$x`` and ``${x}`` for declared parameters become ``payload.x``."""
    arguments.take(written, name)
    if isinstance(value, str) and "$" in value:
        whole = re.fullmatch(r"\$(?:(\w+)|\{(\w+)\})", value)
        if whole and (whole[1] or whole[2]) in parameters:
            arguments[name] = f"payload.{whole[1] or whole[2]}"
            return

        def inside(match: re.Match[str]) -> str:
            key = match[1] or match[2]
            return f"${{payload.{key}}}" if key in parameters else match[0]

        arguments[name] = re.sub(r"\$(?:(\w+)|\{(\w+)\})", inside, value)


def _places(table: Table, key: str) -> tuple[Any, Any]:
    return table.keys_at.get(key, table.at), table.values_at.get(key, table.at)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
