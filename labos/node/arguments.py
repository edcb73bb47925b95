"""Arguments of a call against what an action declares.

Nothing is coerced silently, except an integer where a float is wanted: ``"95"`` is not a
temperature.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import msgspec

from labos.core.model import ActionSpec, Arg
from labos.errors import ActionInvalid

_KINDS: dict[str, tuple[type, ...]] = {
    "str": (str,),
    "station": (str,),
    "file": (str,),
    "int": (int,),
    "float": (int, float),
    "bool": (bool,),
    "list": (list, tuple),
    "dict": (dict,),
}
_WORDS = {
    "str": "a text",
    "station": "the name of a station",
    "file": "the name of a file",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "list": "a list",
    "dict": "a mapping",
}


class Problem(msgspec.Struct, frozen=True):
    """What is wrong with one argument; ``argument`` as the caller wrote it."""

    argument: str
    message: str


def problems(spec: ActionSpec, args: Mapping[str, Any]) -> list[Problem]:
    """Everything that is wrong with a call, in the order of declaration; unknown names last."""
    found: list[Problem] = []
    meant = _names(spec)
    for arg in spec.args:
        written = [name for name in args if meant.get(name) == arg.name]
        if len(written) > 1:
            found.append(Problem(written[1], f"is given twice, as {_listed(written)}"))
        elif not written:
            if arg.required:
                found.append(Problem(arg.name, f"is missing: {_wanted(arg)}"))
        elif wrong := _wrong(arg, args[written[0]]):
            found.append(Problem(written[0], wrong))
    known = [arg.name for arg in spec.args]
    takes = f"takes {_listed(known)}" if known else "takes no arguments"
    found.extend(Problem(name, f"is not known: {spec.name} {takes}") for name in args if name not in meant)
    return found


def bind(spec: ActionSpec, args: Mapping[str, Any]) -> dict[str, Any]:
    """The call's arguments under their declared names, defaults left out.

    Raises ActionInvalid with one sentence about the first thing that is wrong.
    """
    for problem in problems(spec, args):
        raise ActionInvalid(f"{spec.name}: argument {problem.argument!r} {problem.message}.")
    meant = _names(spec)
    floats = {arg.name for arg in spec.args if arg.type == "float"}
    bound = {meant[name]: value for name, value in args.items()}
    return {
        name: float(value) if name in floats and value is not None else value for name, value in bound.items()
    }


def _names(spec: ActionSpec) -> dict[str, str]:
    """Every name and alias, to the declared name it stands for."""
    meant = {alias: arg.name for arg in spec.args for alias in arg.aliases}
    meant.update({arg.name: arg.name for arg in spec.args})
    return meant


def _wrong(arg: Arg, value: Any) -> str:
    """What is wrong with a value, or nothing."""
    if value is None and not arg.required and arg.default is None:
        return ""
    if arg.type in _KINDS and not _is_kind(arg.type, value):
        return f"must be {_wanted(arg)}, not {_shown(value)}"
    if isinstance(value, float) and not math.isfinite(value):
        return f"must be {_wanted(arg)}, not {value}"
    if arg.choices and value not in arg.choices:
        return f"must be {_wanted(arg)}, not {_shown(value)}"
    if isinstance(value, int | float) and not isinstance(value, bool) and not _within(arg, value):
        return f"must be {_wanted(arg)}, not {value:g}"
    return ""


def _is_kind(kind: str, value: Any) -> bool:
    if isinstance(value, bool):
        return kind == "bool"
    return isinstance(value, _KINDS[kind])


def _within(arg: Arg, value: float) -> bool:
    low = -math.inf if arg.minimum is None else arg.minimum
    high = math.inf if arg.maximum is None else arg.maximum
    return low <= value <= high


def _wanted(arg: Arg) -> str:
    """What the argument takes: ``a number from 0.5 to 9.9 s``."""
    if arg.choices:
        return f"one of {_listed(arg.choices)}"
    words = [_WORDS.get(arg.type, "a value")]
    if arg.minimum is not None and arg.maximum is not None:
        words.append(f"from {arg.minimum:g} to {arg.maximum:g}")
    elif arg.minimum is not None:
        words.append(f"of at least {arg.minimum:g}")
    elif arg.maximum is not None:
        words.append(f"of at most {arg.maximum:g}")
    if arg.unit:
        words.append(arg.unit if len(words) > 1 else f"in {arg.unit}")
    return " ".join(words)


def _listed(values: Any) -> str:
    return ", ".join(str(value) for value in values)


def _shown(value: Any) -> str:
    text = f'"{value}"' if isinstance(value, str) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"
