"""Binds written arguments to what an action takes: names, types, units, ranges, choices."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from labos.core.canonical import refuse_non_finite
from labos.core.model import ActionSpec, Arg
from labos.spec.durations import QUANTITY, SECONDS
from labos.spec.findings import near

Tell = Callable[[str, str, str], None]
"""Called with an argument's written name (empty for the action itself), what is wrong, a remedy."""

_PLAIN: dict[str, type] = {"str": str, "bool": bool, "list": list, "dict": dict, "station": str, "file": str}
_TEMPERATURE = ("C", "°C", "degC", "celsius")


def bind(action: ActionSpec, written: Mapping[str, Any], tell: Tell) -> dict[str, Any]:
    """The arguments under their own names, defaults filled in. An optional argument that was
    given nothing is left out. Faults go to ``tell``."""
    bound: dict[str, Any] = {}
    by_name = {name: arg for arg in action.args for name in (*arg.aliases, arg.name)}
    for name, value in written.items():
        arg = by_name.get(name)
        if arg is None:
            tell(
                name,
                f"The action {action.name!r} has no argument {name!r}.",
                near(name, [arg.name for arg in action.args], "argument"),
            )
        elif arg.name in bound:
            tell(name, f"The argument {arg.name!r} is given twice, once as {name!r}.", "Remove one of them.")
        elif value is None and not arg.required:
            continue
        else:
            bound[arg.name] = _checked(arg, name, value, tell)
    for arg in action.args:
        if (
            arg.name not in bound
            and arg.required
            and not any(name in written for name in (arg.name, *arg.aliases))
        ):
            tell("", f"The action {action.name!r} needs the argument {arg.name!r}.", _how(arg))
        elif arg.name not in bound and arg.default is not None:
            bound[arg.name] = arg.default
    return bound


def is_later(value: Any) -> bool:
    """Whether the value comes from the result of an earlier step."""
    return isinstance(value, dict) and set(value) == {"$result"}


def _checked(arg: Arg, name: str, value: Any, tell: Tell) -> Any:
    if is_later(value):
        return value
    try:
        refuse_non_finite(value)
        value = _typed(arg, value)
        _in_range(arg, value)
    except ValueError as problem:
        tell(name, f"{_name(arg, name)} {problem}.", _how(arg))
    return value


def _name(arg: Arg, name: str) -> str:
    return f"The argument {name!r}" + (f" ({arg.name})" if name != arg.name else "")


def _typed(arg: Arg, value: Any) -> Any:
    if arg.type in ("int", "float"):
        return _number(arg, value)
    expected = _PLAIN.get(arg.type)
    if expected is None:
        return value
    if isinstance(value, tuple) and expected is list:
        return list(value)
    if not isinstance(value, expected):
        if arg.type == "station" and isinstance(value, list):
            raise ValueError("must name a station; joint angles alone do not say what is there")
        raise ValueError(f"must be {_TYPES[arg.type]}, not {_written(value)}")
    if arg.type in ("station", "file") and not value:
        if arg.required:
            raise ValueError("is empty")
        return value
    return value


_TYPES = {
    "str": "text",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "list": "a list",
    "dict": "a table",
    "station": "a station's name",
    "file": "a file's path",
}


def _number(arg: Arg, value: Any) -> int | float:
    if isinstance(value, str):
        value = _with_unit(arg, value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"must be {_TYPES[arg.type]}, not {_written(value)}")
    if arg.type == "int":
        if isinstance(value, float):
            if not value.is_integer():
                raise ValueError(f"must be a whole number, not {value}")
            return int(value)
        return value
    return value


def _with_unit(arg: Arg, text: str) -> Any:
    """``"2 min"`` for an argument in seconds."""
    match = QUANTITY.fullmatch(text)
    if not match or not match[2]:
        return text
    number, unit = float(match[1]), match[2]
    if unit == arg.unit or (unit in _TEMPERATURE and arg.unit in _TEMPERATURE):
        return number
    if unit in SECONDS and arg.unit in SECONDS:
        return number * SECONDS[unit] / SECONDS[arg.unit]
    wanted = f"is in {arg.unit}" if arg.unit else "has no unit"
    raise ValueError(f"{wanted}, not in {unit!r}")


def _in_range(arg: Arg, value: Any) -> None:
    if arg.choices and value not in arg.choices:
        raise ValueError(f"cannot be {_written(value)}")
    if isinstance(value, int | float) and not isinstance(value, bool):
        unit = f" {arg.unit}" if arg.unit else ""
        if arg.minimum is not None and value < arg.minimum:
            raise ValueError(f"is {value}{unit}, less than {arg.minimum:g}{unit}")
        if arg.maximum is not None and value > arg.maximum:
            raise ValueError(f"is {value}{unit}, more than {arg.maximum:g}{unit}")


def _how(arg: Arg) -> str:
    """What the argument takes, as a remedy."""
    if arg.choices:
        return "Write one of " + ", ".join(repr(choice) for choice in arg.choices) + "."
    unit = f" {arg.unit}" if arg.unit else ""
    what = _TYPES.get(arg.type, "a value")
    if arg.minimum is not None and arg.maximum is not None:
        return f"Write {what} from {arg.minimum:g} to {arg.maximum:g}{unit}."
    if arg.minimum is not None:
        return f"Write {what} of at least {arg.minimum:g}{unit}."
    if arg.maximum is not None:
        return f"Write {what} of at most {arg.maximum:g}{unit}."
    if arg.unit:
        return f"Write {what} in {arg.unit}."
    return f"Write {what} for {arg.name!r}."


def _written(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "…"
