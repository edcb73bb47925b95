"""The arguments of an action: names, types, ranges and choices, checked in one place.

Nothing is converted here: ``"95"`` is not a temperature. Code that reads files and requests of people
(``labos.spec``) turns ``2 min`` into seconds before; a node checks the values exactly as it receives them.
"""

from __future__ import annotations

import math
from typing import Any

from labos.core.model import ActionSpec, Arg

_KINDS: dict[str, tuple[str, tuple[type, ...]]] = {
    "str": ("a text", (str,)),
    "station": ("the name of a station", (str,)),
    "file": ("the name of a file", (str,)),
    "int": ("a whole number", (int,)),
    "float": ("a number", (int, float)),
    "bool": ("true or false", (bool,)),
    "list": ("a list", (list, tuple)),
    "dict": ("a mapping", (dict,)),
}
"""The types of arguments, in words and in Python."""


def list_names(spec: ActionSpec) -> dict[str, Arg]:
    """Maps every name and alias of an action's arguments to the argument."""
    meant = {alias: arg for arg in spec.args for alias in arg.aliases}
    return meant | {arg.name: arg for arg in spec.args}


def find_flaw(arg: Arg, value: Any) -> str:
    """The fault of a value, as the end of a sentence about it; empty if it has none."""
    if value is None and not arg.required and arg.default is None:
        return ""
    if arg.type in _KINDS and not _is_kind(arg.type, value):
        return f"must be {_KINDS[arg.type][0]}, not {shorten(value)}"
    if isinstance(value, float) and not math.isfinite(value):
        return f"must be finite, not {value}"
    if arg.choices and value not in arg.choices:
        return f"cannot be {shorten(value)}"
    if isinstance(value, int | float) and not isinstance(value, bool):
        return _explain_out_of_range(arg, value)
    return ""


def describe_arg(arg: Arg) -> str:
    """The values that the argument takes: ``a number from 0.5 to 9.9 s``."""
    if arg.choices:
        return f"one of {', '.join(shorten(choice) for choice in arg.choices)}"
    words = [_KINDS[arg.type][0] if arg.type in _KINDS else "a value"]
    if arg.minimum is not None and arg.maximum is not None:
        words.append(f"from {arg.minimum:g} to {arg.maximum:g}")
    elif arg.minimum is not None:
        words.append(f"of at least {arg.minimum:g}")
    elif arg.maximum is not None:
        words.append(f"of at most {arg.maximum:g}")
    if unit_of(arg):
        words.append(arg.unit if len(words) > 1 else f"in {arg.unit}")
    return " ".join(words)


def unit_of(arg: Arg) -> str:
    """An argument's unit for messages; empty for a number without a unit (``1``)."""
    return "" if arg.unit == "1" else arg.unit


def shorten(value: Any) -> str:
    """A value for messages, shortened."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


def _is_kind(kind: str, value: Any) -> bool:
    if isinstance(value, bool):
        return kind == "bool"
    return isinstance(value, _KINDS[kind][1])


def _explain_out_of_range(arg: Arg, value: float) -> str:
    unit = f" {unit_of(arg)}" if unit_of(arg) else ""
    if arg.minimum is not None and value < arg.minimum:
        return f"is {value:.10g}{unit}, less than {arg.minimum:g}{unit}"
    if arg.maximum is not None and value > arg.maximum:
        return f"is {value:.10g}{unit}, more than {arg.maximum:g}{unit}"
    return ""
