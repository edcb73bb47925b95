"""Converts foreign names of types to those of LabOS."""

from __future__ import annotations

import re
from typing import Any

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
