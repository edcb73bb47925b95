"""Placeholders in the tables of a workcell file: ``{name}`` in a text is replaced by a value; a text that is
only a placeholder becomes the value itself."""

from __future__ import annotations

import re
from typing import Any

from labos.errors import DeviceError

_PLACE = re.compile(r"\{(\w+)\}")


def fill(written: Any, values: dict[str, Any], table: str, *, leave_out: bool = False) -> Any:
    """The content of ``table`` with its placeholders filled in. With ``leave_out``, a key whose value is only
    a placeholder of an argument that was not given is left out. Raises DeviceError (``none``)."""
    if isinstance(written, dict):
        given = {k: v for k, v in written.items() if not (leave_out and _is_absent(v, values))}
        return {key: fill(value, values, table, leave_out=leave_out) for key, value in given.items()}
    if isinstance(written, list):
        return [fill(value, values, table, leave_out=leave_out) for value in written]
    if not isinstance(written, str):
        return written
    for name in _PLACE.findall(written):
        if name not in values:
            raise DeviceError(f"`{table}:` needs the argument {name!r}, which was not given.", effects="none")
    if whole := _PLACE.fullmatch(written):
        return values[whole[1]]
    return _PLACE.sub(lambda found: str(values[found[1]]), written)


def _is_absent(written: Any, values: dict[str, Any]) -> bool:
    whole = _PLACE.fullmatch(written) if isinstance(written, str) else None
    return whole is not None and whole[1] not in values
