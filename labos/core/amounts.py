"""Amounts that the arguments of an action decide: how much it uses up, how long it takes.

An amount is written as a place-holder: ``{arg}`` is the argument's own number; ``{arg.sum}``, ``{arg.count}``
and ``{arg.max}`` are computed from a list.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from labos.core.model import ActionSpec
from labos.errors import SpecError

_IN_ARGUMENT = re.compile(r"\{(?P<arg>\w+)(?:\.(?P<how>sum|count|max))?\}")
_DURATION = re.compile(r"(?:(?P<base>\d+(?:\.\d+)?) *\+ *)?(?P<amount>\{[^{}]+\})")
_SECONDS = {"ms": 0.001, "s": 1.0, "min": 60.0, "h": 3600.0}


def find_argument(text: str) -> str:
    """The argument that an amount depends on; empty if the text is not such a place-holder."""
    found = _IN_ARGUMENT.fullmatch(text)
    return found["arg"] if found else ""


def count_argument(text: str, values: Mapping[str, Any]) -> float:
    """The number that a place-holder of an argument stands for. Raises SpecError."""
    found = _IN_ARGUMENT.fullmatch(text)
    if not found:
        raise SpecError(
            f"{text!r} is not an amount.", remedy="Write a number, or a place-holder as {wells.count}."
        )
    if found["arg"] not in values:
        raise SpecError(
            f"There is no argument {found['arg']!r}.", remedy=f"Arguments: {', '.join(sorted(values))}."
        )
    value = values[found["arg"]]
    if not found["how"]:
        return check_amount(value, f"The argument {found['arg']!r}")
    items = value or []
    if not isinstance(items, list | tuple):
        raise SpecError(
            f"The argument {found['arg']!r} is not a list.", remedy="Write one value for each well."
        )
    if found["how"] == "count":
        return float(len(items))
    numbers = [check_amount(item, f"A value of {found['arg']!r}") for item in items]
    return math.fsum(numbers) if found["how"] == "sum" else max(numbers, default=0.0)


def check_amount(value: Any, what: str) -> float:
    """The value as an amount. Raises SpecError."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise SpecError(f"{what} is not a number, but an amount depends on it.", remedy="Write a number.")
    if not 0 <= value < math.inf:
        raise SpecError(f"{what} is {value}, but an amount cannot be negative.", remedy="Write 0 or more.")
    return float(value)


def find_duration_s(
    action: ActionSpec,
    values: Mapping[str, Any],
    count: Callable[[str, Mapping[str, Any]], float] = count_argument,
) -> float:
    """How long an action with these arguments takes, in lab seconds (``ActionSpec.duration_from``). It is the
    nominal duration if an argument is not known yet, was not given, or ``count`` finds nothing (0). Raises
    SpecError for a value that is not a duration."""
    found = _DURATION.fullmatch(action.duration_from)
    if found is None:
        if action.duration_from:
            raise SpecError(
                f"{action.duration_from!r} is not a duration.",
                remedy="Write a place-holder as {seconds}, or 20 + {seconds}.",
            )
        return action.duration_s
    name = find_argument(found["amount"])
    values = {arg.name: arg.default for arg in action.args} | dict(values)
    if name in values and values[name] in (None, ""):
        return action.duration_s
    amount = count(found["amount"], values)
    unit = next((arg.unit for arg in action.args if arg.name == name), "")
    return float(found["base"] or 0) + amount * _SECONDS.get(unit, 1.0) or action.duration_s


def set_duration(action: ActionSpec, args: Mapping[str, Any]) -> ActionSpec:
    """The action with the duration for these arguments. It keeps its nominal duration if a file decides
    it."""
    if not action.duration_from:
        return action
    try:
        return msgspec.structs.replace(action, duration_s=find_duration_s(action, args))
    except SpecError:
        return action
