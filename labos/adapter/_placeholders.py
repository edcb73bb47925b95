"""Placeholders in the tables of a workcell file: ``{name}`` in a text is replaced by a value; a text that is
only a placeholder becomes the value itself."""

from __future__ import annotations

import re
from typing import Any

from labos.errors import DeviceError

_PLACE = re.compile(r"\{(\w+)\}")


def fill(written: Any, values: dict[str, Any], table: str) -> Any:
    """The content of ``table`` with its placeholders filled in. Raises DeviceError (``none``)."""
    if isinstance(written, dict):
        return {key: fill(value, values, table) for key, value in written.items()}
    if isinstance(written, list):
        return [fill(value, values, table) for value in written]
    if not isinstance(written, str):
        return written
    for name in _PLACE.findall(written):
        if name not in values:
            raise DeviceError(f"`{table}:` needs the argument {name!r}, which was not given.", effects="none")
    if whole := _PLACE.fullmatch(written):
        return values[whole[1]]
    return _PLACE.sub(lambda found: str(values[found[1]]), written)
