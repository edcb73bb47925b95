"""MADSci's workflow parameters: typed lists, their simplified forms, and those written inline."""

from __future__ import annotations

import re
from typing import Any

from labos.spec.dialects._reader import Reader
from labos.spec.source import Path_, SourceMapping

ALIASES = ("parameters", "params", "workflow_params", "workflow_parameters")
SECTIONS = {
    "json_inputs": "json_input",
    "value_inputs": "json_input",
    "json": "json_input",
    "inputs": "json_input",
    "file_inputs": "file_input",
    "files": "file_input",
    "feed_forward": "feed_forward",
}
_FILES = ("file", "file_input", "input_file")
_KEY = re.compile(r"[A-Za-z_][\w.\-]*")


class Parameters:
    """Declared parameters: those that the payload holds, and those that earlier steps return."""

    def __init__(self, reader: Reader) -> None:
        self.reader = reader
        self.inputs: dict[str, SourceMapping] = {}
        self.files: set[str] = set()
        self.forward: dict[str, tuple[SourceMapping, Path_]] = {}
        for name in ALIASES:
            if reader.source.data.get(name) is not None:
                self._read(reader.source.data[name], (name,))
                break

    def make_form(self, at: Any) -> SourceMapping:
        """The parameters in LabOS' form, without those that earlier steps return."""
        out = SourceMapping(at)
        for name, entry in self.inputs.items():
            parameter = SourceMapping(entry.at)
            if entry.get("default") is not None and name not in self.files:
                parameter.take(entry, "default")
            else:
                parameter.put("required", True)
            description = str(entry.get("description") or "")
            if name in self.files:
                description = f"path of a file; {description}" if description else "path of a file"
            if description:
                parameter.put("description", description)
            out.put(name, parameter)
        return out

    def declare(self, entry: SourceMapping, path: Path_, kind: str = "") -> str:
        """Add a parameter, and return its key."""
        kind = str(entry.get("parameter_type") or kind)
        if not kind:
            simple = str(entry.get("type", "")).lower().strip()
            kind = "file_input" if simple in _FILES else "json_input"
        key = entry.get("key") or entry.get("name")
        if not isinstance(key, str) or not _KEY.fullmatch(key):
            raise self.reader.source.error(
                "A parameter has no key that LabOS can use.", path, remedy="Write `key:` with a plain name."
            )
        if key in self.inputs or key in self.forward:
            raise self.reader.source.error(
                f"The parameter {key!r} is declared twice.", path, remedy="Rename one of them."
            )
        if kind.startswith("feed_forward"):
            self.forward[key] = (entry, path)
        else:
            self.inputs[key] = entry
            if kind == "file_input":
                self.files.add(key)
        return key

    def find_default(self, key: str) -> Any:
        """The default of an input; None without one."""
        entry = self.inputs.get(key)
        return None if entry is None else entry.get("default")

    def _read(self, value: Any, path: Path_) -> None:
        if not isinstance(value, SourceMapping):
            for index, entry in enumerate(self.reader.expect_sequence(value, path, "the parameters")):
                at = (*path, index)
                self.declare(self.reader.expect_table(entry, at, "A parameter"), at)
            return
        for section, entries in value.items():
            if section not in SECTIONS:
                self.reader.ignore((*path, section))
            elif entries is not None:
                rows = self.reader.expect_sequence(entries, (*path, section), "the parameters")
                for index, entry in enumerate(rows):
                    at = (*path, section, index)
                    self.declare(self.reader.expect_table(entry, at, "A parameter"), at, SECTIONS[section])
