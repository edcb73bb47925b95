"""YAML with positions: every key and value has the line and column where it was written.

The data is plain (dict, list, str, int, float, bool, None), except for the containers. These are
``SourceMapping`` and ``SourceList``, which have places. Numbers follow YAML 1.2 (``1e-3`` is a number,
``12:30`` and dates are text); ``yes``, ``no``, ``on`` and ``off`` are still booleans, because files of other
laboratories, written for YAML 1.1, depend on it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from labos.core.canonical import digest
from labos.errors import SpecError

MAX_BYTES = 4 * 1024 * 1024
MAX_VALUES = 100_000
MAX_DEPTH = 64
TOO_MUCH = "Keep data in separate files and name them in arguments."


class Place(NamedTuple):
    """Line and column, counted from 1; 0 for nowhere."""

    line: int = 0
    column: int = 0


NOWHERE = Place()
Path_ = Sequence[str | int]


class SourceMapping(dict[str, Any]):
    """A mapping with the places of itself, its keys and its values. ``values`` are put into it."""

    def __init__(self, at: Place = NOWHERE, values: Mapping[str, Any] = {}) -> None:
        super().__init__()
        self.at = at
        self.keys_at: dict[str, Place] = {}
        self.values_at: dict[str, Place] = {}
        for key, value in values.items():
            self.put(key, value)

    def put(self, key: str, value: Any, key_at: Place | None = None, value_at: Place | None = None) -> None:
        """Without places, they are that of the value, or of the mapping if the value has none itself."""
        own = value.at if isinstance(value, SourceMapping | SourceList) else self.at
        self[key] = value
        self.keys_at[key] = key_at or own
        self.values_at[key] = value_at or own

    def take(self, other: SourceMapping, key: str, name: str = "") -> None:
        """Copy an entry with its places, under another name if one is given."""
        self.put(name or key, other[key], *other.find_places(key))

    def find_places(self, key: str) -> tuple[Place, Place]:
        """The places of a key and of its value; those of the mapping if the key is missing."""
        return self.keys_at.get(key, self.at), self.values_at.get(key, self.at)


class SourceList(list[Any]):
    """A sequence with the places of itself and its values."""

    def __init__(self, at: Place = NOWHERE) -> None:
        super().__init__()
        self.at = at
        self.values_at: list[Place] = []

    def put(self, value: Any, at: Place = NOWHERE) -> None:
        self.append(value)
        self.values_at.append(at)


class Source:
    """A file as it was read: its data with all places, and the digest of its bytes."""

    def __init__(self, file: str, data: SourceMapping, digest: str, folder: Path | None = None) -> None:
        self.file, self.data, self.digest, self.folder = file, data, digest, folder
        self.written_as: dict[str, str] = {}
        """Top-level keys that have another name in the dialect, for messages."""
        self.moved: dict[str, str] = {}
        """Fields of a foreign file, and their places in LabOS' form."""
        self.text = ""
        """The file as text."""
        self.doubles: tuple[SpecError, ...] = ()
        """Keys that occur twice in one table, of which the last one was used."""

    def name_field(self, path: Path_) -> str:
        """The path in the form for messages: ``steps[2].args.time``."""
        if path and path[0] in self.written_as:
            path = (self.written_as[str(path[0])], *path[1:])
        return name_field(path)

    def place(self, path: Path_, *, key: bool = False) -> Place:
        """The place of the value at the path (of its key, if ``key``). If it is missing, the place of the
        innermost existing part of the path."""
        here: Any = self.data
        at = self.data.at
        for part in path:
            if isinstance(here, SourceMapping) and isinstance(part, str) and part in here:
                at = (here.keys_at if key else here.values_at).get(part) or at
            elif isinstance(here, SourceList) and isinstance(part, int) and part < len(here):
                at = here.values_at[part] if part < len(here.values_at) else at
            elif isinstance(here, SourceMapping) and part == 0:
                continue  # a single value instead of a list of them
            else:
                break
            here = here[part]
        return at

    def error(self, message: str, path: Path_ = (), *, key: bool = False, remedy: str = "") -> SpecError:
        """A SpecError at the place of a path."""
        return _make_error(self.file, message, self.place(path, key=key), remedy, self.name_field(path))


def _make_error(file: str, message: str, at: Place, remedy: str, field: str = "") -> SpecError:
    return SpecError(message, file=file, line=at.line, column=at.column, field=field, remedy=remedy)


def name_field(path: Path_) -> str:
    """The path in the form ``steps[2].args.time``."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def make_plain(value: Any) -> Any:
    """The same data in ordinary containers."""
    if isinstance(value, dict):
        return {key: make_plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [make_plain(item) for item in value]
    return value


def read(path: str | Path, *, last_wins: bool = False) -> Source:
    """Read a YAML file. A key that occurs twice is refused. With ``last_wins`` it is only noted in the
    source's ``doubles``, for code that knows the file's dialect. Raises SpecError."""
    path = Path(path)
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except OSError as error:
        reason = error.strerror or str(error)
        raise SpecError(
            f"The file cannot be read: {reason}.", file=str(path), remedy="Check its path."
        ) from None
    return parse(raw, str(path), path.resolve().parent, last_wins=last_wins)


def parse(
    text: str | bytes, file: str = "", folder: Path | None = None, *, last_wins: bool = False
) -> Source:
    """Read YAML text, as ``read`` does a file. Raises SpecError."""
    raw = text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text
    if len(raw) > MAX_BYTES:
        message = f"The file is larger than {MAX_BYTES // 1024 // 1024} MB."
        raise _make_error(file, message, NOWHERE, TOO_MUCH)
    try:
        written = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        at = Place(raw.count(b"\n", 0, error.start) + 1, 1)
        raise _make_error(file, "The file is not text.", at, "Save it as UTF-8 YAML.") from None
    try:
        node = _Loader(written).get_single_node()
    except yaml.MarkedYAMLError as error:
        at = _mark(error.problem_mark or error.context_mark)
        message = f"This is not YAML: {_explain_plainly(error.problem or error.context or '')}."
        remedy = "Check indentation, quotes and colons just before this place."
        raise _make_error(file, message, at, TOO_MUCH if isinstance(error, _TooMuch) else remedy) from None
    except yaml.reader.ReaderError as error:
        at = Place(written.count("\n", 0, int(error.position)) + 1, 1)
        message = "The file contains characters that are not text."
        raise _make_error(file, message, at, "Is it a YAML file? Save it as UTF-8 text.") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise SpecError(f"This is not YAML: {error}.", file=file, remedy="Rewrite the file.") from None
    builder = _Builder(file)
    data = builder.build(node) if node is not None else None
    if builder.doubles and not last_wins:
        raise builder.doubles[0]
    if not isinstance(data, SourceMapping):
        what = "empty" if data is None else "not a table of keys and values"
        remedy = "Write `key: value` lines at the top level."
        raise _make_error(file, f"The file is {what}.", Place(1, 1), remedy)
    source = Source(file, data, digest(raw), folder)
    source.text, source.doubles = written, tuple(builder.doubles)
    return source


def _explain_plainly(problem: str) -> str:
    """Plain explanations for messages of the parser that the author of a file would not understand."""
    if problem == "expected <block end>, but found '?'":
        return "the indentation of this key fits no line above it"
    if problem == "expected <block end>, but found '-'":
        return "the indentation of this dash fits no line above it"
    return problem


def _mark(mark: Any) -> Place:
    return Place(mark.line + 1, mark.column + 1) if mark is not None else NOWHERE


class _TooMuch(yaml.composer.ComposerError):
    """The file is larger than any workcell or workflow."""


class _Loader(yaml.SafeLoader):
    """PyYAML's parser with YAML 1.2 numbers and limits on depth and size."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._depth = 0
        self._count = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        self._depth += 1
        self._count += 1
        if self._depth > MAX_DEPTH:
            raise self._make_too_much_error(f"it is nested more than {MAX_DEPTH} levels deep")
        if self._count > MAX_VALUES:
            raise self._make_too_much_error(f"it holds more than {MAX_VALUES} values")
        try:
            return super().compose_node(parent, index)
        finally:
            self._depth -= 1

    def _make_too_much_error(self, problem: str) -> _TooMuch:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        return _TooMuch(None, None, problem, event.start_mark)


_INT = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(
    r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
)
_BOOL = re.compile("yes|Yes|YES|no|No|NO|true|True|TRUE|false|False|FALSE|on|On|ON|off|Off|OFF")
_NULL = re.compile("~|null|Null|NULL|")
_MERGE = "tag:yaml.org,2002:merge"

_Loader.yaml_implicit_resolvers = {}
for _tag, _pattern, _first in (
    ("null", _NULL, "~nN\0"),
    ("bool", _BOOL, "yYnNtTfFoO"),
    ("int", _INT, "-+0123456789"),
    ("float", _FLOAT, "-+0123456789."),
    ("merge", re.compile("<<"), "<"),
):
    _Loader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_tag}",
        re.compile(f"^(?:{_pattern.pattern})$"),
        [c if c != "\0" else "" for c in _first],
    )


class _Builder:
    """Converts composed nodes to data, within limits."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.count = 0
        self.open: set[int] = set()
        self.doubles: list[SpecError] = []

    def build(self, node: yaml.Node) -> Any:
        self.count += 1
        at = _mark(node.start_mark)
        if self.count > MAX_VALUES:
            raise self._make_error("The file expands to too many values.", at, "Use fewer aliases (`*name`).")
        if id(node) in self.open:
            raise self._make_error("An alias contains itself.", at, "Write the values out.")
        if len(self.open) >= MAX_DEPTH:
            raise self._make_error(
                f"The file is nested more than {MAX_DEPTH} levels deep.", at, "Use fewer aliases."
            )
        self.open.add(id(node))
        try:
            if isinstance(node, yaml.MappingNode):
                return self._build_table(node, at)
            if isinstance(node, yaml.SequenceNode):
                return self._build_row(node, at)
            return self._build_scalar(node, at)
        finally:
            self.open.discard(id(node))

    def _make_error(self, message: str, at: Place, remedy: str, field: str = "") -> SpecError:
        return _make_error(self.file, message, at, remedy, field)

    def _build_table(self, node: yaml.MappingNode, at: Place) -> SourceMapping:
        if node.tag != "tag:yaml.org,2002:map":
            raise self._make_error(f"The tag {node.tag} is not supported.", at, "Remove it.")
        table = SourceMapping(at)
        merged: list[SourceMapping] = []
        for key_node, value_node in node.value:
            key_at = _mark(key_node.start_mark)
            if not isinstance(key_node, yaml.ScalarNode):
                raise self._make_error("A key must be a single word or text.", key_at, "Write `key: value`.")
            if key_node.tag == _MERGE:
                value = self.build(value_node)
                merged += value if isinstance(value, SourceList) else [value]
                if not all(isinstance(part, SourceMapping) for part in merged):
                    raise self._make_error("`<<` merges tables only.", key_at, "Point it at a table.")
                continue
            key = key_node.value
            if key in table:
                first = table.keys_at[key]
                what = f"The key {key!r} is there twice; the first is in line {first.line}."
                self.doubles.append(self._make_error(what, key_at, "Remove or rename one of them.", key))
            table.put(key, self.build(value_node), key_at, _mark(value_node.start_mark))
        for part in merged:
            for key in part:
                if key not in table:
                    table.take(part, key)
        return table

    def _build_row(self, node: yaml.SequenceNode, at: Place) -> SourceList:
        if node.tag != "tag:yaml.org,2002:seq":
            raise self._make_error(f"The tag {node.tag} is not supported.", at, "Remove it.")
        row = SourceList(at)
        for item in node.value:
            row.put(self.build(item), _mark(item.start_mark))
        return row

    def _build_scalar(self, node: yaml.Node, at: Place) -> Any:
        text = str(node.value)
        match node.tag.removeprefix("tag:yaml.org,2002:"):
            case "null":
                return None
            case "bool":
                return text.lower() in ("yes", "true", "on")
            case "int" | "float" as kind:
                return self._build_number(text, kind, at)
            case "str" | "merge":
                if any("\ud800" <= char <= "\udfff" for char in text):
                    raise self._make_error(
                        "The text holds half a character.", at, "Remove the \\ud8xx escape."
                    )
                return text
        raise self._make_error(f"The tag {node.tag} is not supported.", at, "Remove it.")

    def _build_number(self, text: str, kind: str, at: Place) -> int | float:
        try:
            if kind == "int":
                base = {"0x": 16, "0o": 8}.get(text[:2].lower(), 10)
                whole = int(text, base)
                if not -(2**63) <= whole < 2**63:
                    raise ValueError
                return whole
            number = float(text.replace(".inf", "inf").replace(".nan", "nan"))
        except ValueError:
            raise self._make_error(
                f"{text[:40]} is not a number that can be stored.", at, "Put it in quotes."
            ) from None
        if not math.isfinite(number):
            raise self._make_error(f"{text} is not a finite number.", at, "Write a number or leave it out.")
        return number
