"""The amount that an action will use up, computed when its run is submitted.

A driver may state an amount as a number or as one place-holder:

- ``{arg}``: the argument's own number; ``{arg.sum}``, ``{arg.count}``, ``{arg.max}`` of a list
- ``{file:arg:path.to.value}``: a number in the YAML or JSON file that the argument names. The file
  itself may contain a place-holder of an argument. The number after a ``|`` is used if the file does not
  have the value and the driver cannot count it: ``{file:protocol:resources.tips|8}``. A warning reports
  this assumption.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from labos.core.amounts import check_amount, count_argument, find_argument
from labos.core.counts import Count, Counter
from labos.errors import SpecError
from labos.spec.source import Path_, parse

_IN_FILE = re.compile(r"\{file:(?P<arg>\w+):(?P<path>[\w.\-]+)(?:\|(?P<otherwise>[\d.]+))?\}")

FileOf = Callable[[str], bytes | None]
"""Returns the content of the file with a name; None if it cannot be found (a warning was given)."""


def list_arguments(text: str) -> set[str]:
    """The arguments that an amount depends on."""
    in_file = _IN_FILE.fullmatch(text)
    name = in_file["arg"] if in_file else find_argument(text)
    return {name} if name else set()


def compute_amount(
    text: str, values: Mapping[str, Any], file_of: FileOf, counter: Counter | None = None
) -> Count:
    """The value of a place-holder. ``counter`` is the driver's function for counting it from the file. Raises
    SpecError, with the place in the file if there is one."""
    in_file = _IN_FILE.fullmatch(text)
    if in_file is None:
        return Count(count_argument(text, values))
    name, path = str(values.get(in_file["arg"], "")), in_file["path"].split(".")
    otherwise = float(in_file["otherwise"]) if in_file["otherwise"] else None
    content = file_of(name)
    amount = None if content is None else _read_from_file(name, content, path, values, must=otherwise is None)
    if amount is not None or otherwise is None:
        return Count(amount or 0.0)
    if content is None:
        why = "it is not here" if name else "no file is named"
        return Count(otherwise, why, "Put the file beside the workflow, and name it.")
    if counter is None:
        return Count(otherwise, "it does not say", f"Write it there: {show_path(path)}.")
    counted = counter(name, content, values)
    if not counted.doubt:
        return counted
    remedy = counted.remedy or f"Write it there: {show_path(path)}."
    return Count(max(counted.amount, otherwise), counted.doubt, remedy)


def show_path(path: list[str]) -> str:
    """The form of a number in a file: ``resources: {tips: N}``."""
    text = "N"
    for part in reversed(path):
        text = f"{part}: {text}" if text == "N" else f"{part}: {{{text}}}"
    return f"`{text}`"


def _read_from_file(
    name: str, content: bytes, path: list[str], values: Mapping[str, Any], *, must: bool
) -> float | None:
    """The value that a file itself states; None if it has none and need not have one."""
    if not must and not name.lower().endswith((".yaml", ".yml", ".json")):
        return None
    source = parse(content, name, last_wins=True)
    here: Any = source.data
    at: Path_ = ()
    for part in path:
        if not isinstance(here, dict) or part not in here:
            if not must:
                return None
            raise source.error(f"It does not say {'.'.join(path)!r}.", at, remedy="Add it, as a number.")
        here, at = here[part], (*at, part)
    try:
        if isinstance(here, str):
            return count_argument(here, values)
        return check_amount(here, f"{'.'.join(path)!r}")
    except SpecError as error:
        raise source.error(error.message, at, remedy=error.remedy) from None
