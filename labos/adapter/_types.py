"""Converts foreign descriptions of actions and arguments, and names of types, to those of LabOS."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from labos.core.model import ActionSpec, Arg

_TYPES = {
    "str": "str",
    "string": "str",
    "int": "int",
    "integer": "int",
    "float": "float",
    "number": "float",
    "bool": "bool",
    "boolean": "bool",
    "list": "list",
    "array": "list",
    "tuple": "list",
    "dict": "dict",
    "object": "dict",
    "location": "station",
    "locationargument": "station",
}
_WRAPPED = re.compile(r"(?:typing\.)?(?:Optional|Annotated|Union)\[(.*)\]", re.IGNORECASE)


def type_of(written: Any) -> str:
    """The LabOS type for a foreign one (``Optional[float]``, ``list[str]``, ``<class 'int'>`` …); ``any`` if
    it is not known."""
    if isinstance(written, list):
        kinds = {type_of(item) for item in written if str(item) not in ("None", "NoneType", "null")}
        return kinds.pop() if len(kinds) == 1 else "any"
    text = str(written).replace("<class '", "").replace("'>", "").strip()
    if wrapped := _WRAPPED.fullmatch(text):
        text = wrapped[1].split(",")[0].strip()
    parts = [part.strip() for part in text.split("|") if part.strip() not in ("None", "NoneType")]
    if len(parts) != 1:
        return "any"
    bare = parts[0].partition("[")[0].rpartition(".")[2].lower()
    return _TYPES.get(bare, "any")


def make_arg(name: Any, written: Mapping[str, Any], kind: str) -> Arg:
    """An argument of a WEI or MADSci node."""
    return Arg(
        name=str(name),
        type=kind,
        required=bool(written.get("required", True)),
        default=written.get("default"),
        description=str(written.get("description") or ""),
    )


def make_action(name: Any, written: Mapping[str, Any], args: Iterable[Arg]) -> ActionSpec:
    """An action of a WEI or MADSci node, without effects."""
    return ActionSpec(
        name=str(name),
        description=str(written.get("description") or "").strip().partition("\n")[0],
        args=tuple(args),
        exclusive=bool(written.get("blocking", True)),
        result="any" if written.get("results") else "",
    )
