"""How much an action will use up, worked out when its run is submitted.

A driver may state an amount as a number or as one place-holder:

- ``{arg}``: the argument's own number; ``{arg.sum}``, ``{arg.count}``, ``{arg.max}`` of a list
- ``{file:arg:path.to.value}``: a number in the YAML or JSON file that the argument names. The file may
  in its turn state a place-holder of an argument. Behind a ``|`` stands what is assumed where the file
  does not say, and the driver cannot count it from the file either: ``{file:protocol:resources.tips|8}``.
  What is assumed is told as a warning.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

from labos.core.counts import Count, Counter
from labos.errors import SpecError
from labos.spec.findings import near
from labos.spec.source import Path_, parse

_IN_FILE = re.compile(r"\{file:(?P<arg>\w+):(?P<path>[\w.\-]+)(?:\|(?P<otherwise>[\d.]+))?\}")
_IN_ARGUMENT = re.compile(r"\{(?P<arg>\w+)(?:\.(?P<how>sum|count|max))?\}")

FileOf = Callable[[str], bytes | None]
"""The content of the file of that name; None where it cannot be had (a warning was given)."""


def arguments_of(text: str) -> set[str]:
    """The arguments that an amount depends on."""
    found = _IN_FILE.fullmatch(text) or _IN_ARGUMENT.fullmatch(text)
    return {found["arg"]} if found else set()


def amount_of(text: str, values: Mapping[str, Any], file_of: FileOf, counter: Counter | None = None) -> Count:
    """What a place-holder stands for; ``counter`` is how the driver counts it from the file. Raises
    SpecError, with the place in the file where there is one."""
    in_file = _IN_FILE.fullmatch(text)
    if in_file is None:
        return Count(_from_arguments(text, values))
    name, path = str(values.get(in_file["arg"], "")), in_file["path"].split(".")
    otherwise = float(in_file["otherwise"]) if in_file["otherwise"] else None
    content = file_of(name)
    said = None if content is None else _read_from_file(name, content, path, values, must=otherwise is None)
    if said is not None or otherwise is None:
        return Count(said or 0.0)
    if content is None:
        why = "it is not here" if name else "no file is named"
        return Count(otherwise, why, "Put the file beside the workflow, and name it.")
    if counter is None:
        return Count(otherwise, "it does not say", f"Say it there: {as_written(path)}.")
    counted = counter(name, content, values)
    if not counted.doubt:
        return counted
    remedy = counted.remedy or f"Say it there: {as_written(path)}."
    return Count(max(counted.amount, otherwise), counted.doubt, remedy)


def as_written(path: list[str]) -> str:
    """How a number is written in a file: ``resources: {tips: N}``."""
    text = "N"
    for part in reversed(path):
        text = f"{part}: {text}" if text == "N" else f"{part}: {{{text}}}"
    return f"`{text}`"


def _from_arguments(text: str, values: Mapping[str, Any]) -> float:
    found = _IN_ARGUMENT.fullmatch(text)
    if not found:
        raise SpecError(
            f"{text!r} is no amount.", remedy="Write a number, or a place-holder as {wells.count}."
        )
    if found["arg"] not in values:
        raise SpecError(
            f"There is no argument {found['arg']!r}.", remedy=near(found["arg"], values, "argument")
        )
    value = values[found["arg"]]
    if not found["how"]:
        return _number(value, f"The argument {found['arg']!r}")
    items = value or []
    if not isinstance(items, list | tuple):
        raise SpecError(f"The argument {found['arg']!r} is no list.", remedy="Write one value a well.")
    if found["how"] == "count":
        return float(len(items))
    numbers = [_number(item, f"A value of {found['arg']!r}") for item in items]
    return math.fsum(numbers) if found["how"] == "sum" else max(numbers, default=0.0)


def _number(value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise SpecError(f"{what} is no number: it decides how much is used up.", remedy="Write a number.")
    if not 0 <= value < math.inf:
        raise SpecError(f"{what} is {value}: less than nothing cannot be used up.", remedy="Write 0 or more.")
    return float(value)


def _read_from_file(
    name: str, content: bytes, path: list[str], values: Mapping[str, Any], *, must: bool
) -> float | None:
    """What a file itself says; None if it does not, and need not."""
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
            return _from_arguments(here, values)
        return _number(here, f"{'.'.join(path)!r}")
    except SpecError as error:
        raise source.error(error.message, at, remedy=error.remedy) from None
