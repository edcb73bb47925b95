"""The dialect of the paper's appendix (SI A.1–A.3) and of its relatives, rpl_wei 0.x and WEI 0.7.

Workcell: ``name, config, modules[name, model, interface|type, config, workcell_coordinates,
positions, active], locations{manipulator: {place: joints}}``. Workflow: ``name, metadata,
modules, flowdef[name, module, action|command, args, files, comment|comments]``.
"""

from __future__ import annotations

import re
from typing import Any

from labos.spec.dialects._reader import Reader, is_number
from labos.spec.findings import FindingList
from labos.spec.source import Path_, Source, SourceList, SourceMapping

WORKCELL_KEYS = {"name", "metadata", "config", "modules", "locations"}
MODULE_KEYS = {"name", "model", "interface", "config", "active"}
ADDRESS = ("ip", "port")
"""The oldest files have these beside ``config``."""

NOBODYS = "locations_of_others"
"""The key in the workcell's ``config`` for the locations of modules that it does not have, so that they are
not lost."""

PLACEHOLDER = "foo"
"""Public files give this argument to actions that take none."""

ABOUT = ("author", "version", "info", "description")
"""Keys that some files have at the root and some under ``metadata``."""

STEP_KEYS = {"name", "module", "action", "comment"}
_PARAMETER = re.compile(r"\$(?:([\w\-]+)|\{([\w\-]+)\})")


def rewrite_workcell(source: Source, report: FindingList) -> Source:
    """Rewrite a workcell file. Raises SpecError for an unknown form."""
    reader = Reader(source, report)
    data = source.data
    out = SourceMapping(data.at)
    config = reader.expect_table(data.get("config"), ("config",), "`config`")
    reader.take_name(out, SourceMapping())
    out.put("config", config, *data.find_places("config"))
    locations, others = _read_locations(reader)
    modules = SourceList(source.place(("modules",)))
    for index, entry in enumerate(reader.expect_row("modules", "the modules")):
        path = ("modules", index)
        module = reader.expect_table(entry, path, "A module")
        modules.put(_rewrite_module(reader, module, path, locations), source.place(path))
        places = others.get(str(module["name"]))
        if places is not None:
            modules[-1]["config"].put("representations", places)
    _add_positions(reader, modules, locations)
    names = {str(module["name"]) for module in modules}
    nobodys = {
        owner: places for owner, places in others.items() if owner not in names and owner != "workcell"
    }
    if nobodys:
        config.put(NOBODYS, SourceMapping(locations.at, nobodys))
    out.put("modules", modules, *data.find_places("modules"))
    out.put("locations", locations, *data.find_places("locations"))
    metadata = reader.expect_table(data.get("metadata"), ("metadata",), "`metadata`")
    for key in ("description", "info"):
        if isinstance(metadata.get(key), str) and "description" not in out:
            out.take(metadata, key, "description")
    reader.ignore_others(data, WORKCELL_KEYS)
    return reader.finish(out)


def _rewrite_module(
    reader: Reader, module: SourceMapping, path: Path_, locations: SourceMapping
) -> SourceMapping:
    if not module.get("name"):
        raise reader.source.error("A module has no name.", (*path, "name"), remedy="Write `- name: …`.")
    out = SourceMapping(module.at)
    config = reader.expect_table(module.get("config"), (*path, "config"), "`config`")
    for key, value in module.items():
        at = (*path, key)
        if value is None:
            continue
        if key == "config":
            continue
        if key in MODULE_KEYS:
            out.take(module, key)
        elif key in ADDRESS and key not in config:
            config.take(module, key)
        elif key == "type" and "interface" not in module:
            out.take(module, key, "interface")
        elif key in ("workcell_coordinates", "location", "coordinates"):
            _rewrite_coordinates(reader, out, module, key, at)
        elif key == "positions":
            _rewrite_positions(reader, module, at, locations)
        elif key in ("comment", "comments", "description"):
            out.take(module, key, "comment")
        else:
            reader.ignore(at)
    out.put("config", config, *module.find_places("config"))
    return out


def _rewrite_coordinates(
    reader: Reader, out: SourceMapping, module: SourceMapping, key: str, path: Path_
) -> None:
    value = module[key]
    if isinstance(value, list) and len(value) == 7:
        out.take(module, key, "coordinates")
        return
    count = f"{len(value)} numbers" if isinstance(value, list) else repr(value)
    message = f"Coordinates are x, y, z and a quaternion, seven numbers; here are {count}."
    reader.add_warning(message, path, "They are ignored; write seven numbers.")


def _rewrite_positions(reader: Reader, module: SourceMapping, path: Path_, locations: SourceMapping) -> None:
    """``positions`` of a module name its places without the manipulators to which the joint values belong."""
    written = reader.expect_table(module["positions"], path, "`positions`")
    owner = locations.get("workcell")
    if owner is None:
        owner = SourceMapping(written.at)
        locations.put("workcell", owner)
    for name in written:
        place = f"{module.get('name')}.{name}"
        at = written.keys_at[name]
        if place not in owner and f"{module.get('name')}" != "None":
            owner.put(place, SourceList(at))


def _add_positions(reader: Reader, modules: SourceList, locations: SourceMapping) -> None:
    """Add the joint values of ``positions`` to the configuration of every module. As in WEI, the node of the
    module that a step uses gets these values, and not LabOS' name for the place. A module's own values take
    precedence. Joint values that are all 0 count as not taught."""
    taught = SourceMapping(modules.at)
    for index, module in enumerate(reader.expect_row("modules", "the modules")):
        written = module.get("positions") if isinstance(module, SourceMapping) else None
        for name, joints in written.items() if isinstance(written, SourceMapping) else ():
            if isinstance(joints, list) and any(joints) and all(map(is_number, joints)):
                at = reader.source.place(("modules", index, "positions", name))
                taught.put(f"{modules[index]['name']}.{name}", joints, at, at)
    for module in modules if taught else ():
        config = module["config"]
        own = locations.get(str(module["name"])) or {}
        ways = {place: way for place, way in taught.items() if not own.get(place)}
        ways |= config.get("representations") or {}
        representations = SourceMapping(taught.at)
        for place, way in ways.items():
            representations.put(place, way, taught.at, taught.at)
        if representations:
            config.put("representations", representations)


def _read_locations(reader: Reader) -> tuple[SourceMapping, dict[str, SourceMapping]]:
    """The joint values by owner and place. The second table has other values, which the module itself may
    understand: they are passed to it as ``representations``."""
    source = reader.source
    written = reader.expect_table(source.data.get("locations"), ("locations",), "`locations`")
    out = SourceMapping(written.at)
    others: dict[str, SourceMapping] = {}
    for owner, value in written.items():
        path = ("locations", owner)
        kept = SourceMapping(source.place(path))
        for place, joints in reader.expect_table(value, path, "A manipulator's locations").items():
            if isinstance(joints, list) and all(is_number(joint) for joint in joints):
                kept.take(value, place)
                continue
            at = value.find_places(place)
            kept.put(place, SourceList(at[1]), *at)
            if joints is not None:
                others.setdefault(owner, SourceMapping(at[0])).put(place, joints, *at)
        out.put(owner, kept, *written.find_places(owner))
    return out, others


def rewrite_workflow(source: Source, report: FindingList) -> Source:
    """Rewrite a workflow file. Raises SpecError for an unknown form."""
    reader = Reader(source, report)
    data = source.data
    out = SourceMapping(data.at)
    metadata = reader.expect_table(data.get("metadata"), ("metadata",), "`metadata`")
    reader.take_name(out, metadata)
    about = SourceMapping(metadata.at)
    for key in metadata:
        about.take(metadata, key)
    for key in ABOUT:
        if key in data:
            about.take(data, key)
    out.put("metadata", about, *data.find_places("metadata"))
    if isinstance(data.get("workcell"), str):
        out.take(data, "workcell")
    if data.get("modules") is not None:
        out.put("modules", _list_module_names(reader), *data.find_places("modules"))
    parameters = _read_parameters(reader)
    if parameters:
        out.put("parameters", parameters, *data.find_places("parameters"))
    steps = SourceList(source.place(("flowdef",)))
    for index, entry in enumerate(reader.expect_row("flowdef", "the steps")):
        path = ("flowdef", index)
        step = _Step(reader, reader.expect_table(entry, path, "A step"), path, parameters)
        steps.put(step.make_form(), source.place(path))
    out.put("steps", steps, *data.find_places("flowdef"))
    known = {"name", "metadata", "modules", "flowdef", "workcell", "parameters", *ABOUT}
    reader.ignore_others(data, known)
    form = reader.finish(out)
    form.written_as = {"steps": "flowdef"}
    form.moved = {f"flowdef[{index}]": f"steps[{index}]" for index in range(len(steps))}
    return form


def _list_module_names(reader: Reader) -> SourceList:
    written = reader.expect_row("modules", "the modules")
    names = SourceList(written.at)
    for index, entry in enumerate(written):
        path = ("modules", index)
        if isinstance(entry, str):
            names.put(entry, reader.source.place(path))
        elif isinstance(entry, SourceMapping) and isinstance(entry.get("name"), str):
            names.put(entry["name"], reader.source.place((*path, "name")))
        else:
            raise reader.source.error("A module has no name.", path, remedy="Write `- name: …`.")
    return names


def _read_parameters(reader: Reader) -> SourceMapping:
    """WEI 0.7: ``parameters: [{name, default}]``."""
    value = reader.source.data.get("parameters")
    out = SourceMapping(reader.source.place(("parameters",)))
    if value is None:
        return out
    for index, entry in enumerate(reader.expect_row("parameters", "the parameters")):
        path = ("parameters", index)
        entry = reader.expect_table(entry, path, "A parameter")
        if not isinstance(entry.get("name"), str):
            raise reader.source.error("A parameter has no name.", path, remedy="Write `- name: …`.")
        parameter = SourceMapping(entry.at)
        if entry.get("default") is not None:
            parameter.take(entry, "default")
        else:
            parameter.put("required", True)
        out.put(entry["name"], parameter)
    return out


class _Step:
    """Converts one step to LabOS' form."""

    def __init__(self, reader: Reader, step: SourceMapping, path: Path_, parameters: SourceMapping) -> None:
        self.reader, self.step, self.path, self.parameters = reader, step, path, parameters
        self.out = SourceMapping(step.at)
        self.arguments = SourceMapping(step.find_places("args")[1])

    def make_form(self) -> SourceMapping:
        step, out = self.step, self.out
        for key, value in step.items():
            self._rewrite_entry(key, value, (*self.path, key))
        if "name" not in out and "action" in out:
            out.take(out, "action", "name")
        if "comment" in out and not isinstance(out["comment"], str):
            out["comment"] = str(out["comment"])
        for key in ("module", "action"):
            if key in out:
                out[key] = self._fill(out[key])
        out.put("args", self.arguments, *step.find_places("args"))
        return out

    def _rewrite_entry(self, key: str, value: Any, at: Path_) -> None:
        step, out, reader = self.step, self.out, self.reader
        if key in ("args", "files"):
            self._take_arguments(value, at)
        elif value is None:
            return
        elif key in STEP_KEYS:
            out.take(step, key)
        elif key == "command" and isinstance(value, SourceMapping):
            self._take_command(value, at)
        elif key == "command" and "action" not in step:
            out.take(step, key, "action")
        elif key == "commands":
            raise reader.source.error(
                "Several commands in one step are a draft that no version of WEI runs.",
                at,
                key=True,
                remedy="Write a step for each, with `action:` and `args:`.",
            )
        elif key == "node" and "module" not in step:
            out.take(step, key, "module")
        elif key == "comments":
            out.take(step, key, "comment")
        elif key == "checks":
            reader.ignore(at, "names checks that LabOS makes itself")
        else:
            reader.ignore(at)

    def _take_command(self, command: SourceMapping, at: Path_) -> None:
        """The oldest files: ``command: {instruction, args, checks, comment}``."""
        for key, value in command.items():
            if key == "instruction" and value is not None:
                self.out.take(command, key, "action")
            elif key == "args":
                self._take_arguments(value, (*at, key))
            elif key in ("comment", "comments") and value is not None:
                self.out.take(command, key, "comment")
            elif value is not None:
                self.reader.ignore((*at, key))

    def _take_arguments(self, value: Any, at: Path_) -> None:
        """``args`` and ``files``; an empty value counts as not given."""
        written = self.reader.expect_table(value, at, f"`{at[-1]}`")
        for name, item in written.items():
            if name == PLACEHOLDER and (len(written) == 1 or item in ("foo", "bar")):
                self.reader.ignore((*at, name), "is a placeholder")
            elif item is not None:
                self.arguments.take(written, name)
                self.arguments[name] = self._fill(item)

    def _fill(self, value: Any) -> Any:
        """WEI's ``$x`` and ``${x}`` for declared parameters become ``payload.x``, at any depth."""
        if isinstance(value, SourceMapping):
            for key in value:
                value[key] = self._fill(value[key])
        elif isinstance(value, SourceList):
            value[:] = [self._fill(item) for item in value]
        elif isinstance(value, str) and "$" in value:
            whole = _PARAMETER.fullmatch(value)
            if whole and (whole[1] or whole[2]) in self.parameters:
                return f"payload.{whole[1] or whole[2]}"
            return _PARAMETER.sub(self._rewrite_reference, value)
        return value

    def _rewrite_reference(self, found: re.Match[str]) -> str:
        name = found[1] or found[2]
        return f"${{payload.{name}}}" if name in self.parameters else found[0]
