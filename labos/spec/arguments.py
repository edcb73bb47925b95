"""Binds written arguments to the arguments of an action.

Values in files may have convenient forms (``2 min`` for seconds, ``175.0`` for a whole number). The allowed
values are defined in ``labos.core.arguments``, which nodes use too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from labos.core.arguments import describe_arg, find_flaw, list_names, unit_of
from labos.core.canonical import refuse_non_finite
from labos.core.model import ActionSpec, Arg
from labos.spec.durations import SECONDS, match_quantity
from labos.spec.findings import suggest_name

AddFinding = Callable[[str, str, str], None]
"""Called with an argument's written name (empty for the action itself), the fault, and a remedy."""

_TEMPERATURE = ("C", "°C", "degC", "celsius")


def bind(action: ActionSpec, written: Mapping[str, Any], add_finding: AddFinding) -> dict[str, Any]:
    """The arguments under their own names, with defaults filled in. An optional argument with an empty value
    is left out. Faults go to ``tell``."""
    bound: dict[str, Any] = {}
    by_name = list_names(action)
    for name, value in written.items():
        arg = by_name.get(name)
        if arg is None:
            add_finding(
                name,
                f"The action {action.name!r} has no argument {name!r}.",
                suggest_name(name, [arg.name for arg in action.args], "argument"),
            )
        elif arg.name in bound:
            add_finding(
                name, f"The argument {arg.name!r} is given twice, once as {name!r}.", "Remove one of them."
            )
        elif value is None and not arg.required:
            continue
        else:
            bound[arg.name] = _check(arg, name, value, add_finding)
    for arg in action.args:
        if (
            arg.name not in bound
            and arg.required
            and not any(name in written for name in (arg.name, *arg.aliases))
        ):
            add_finding("", f"The action {action.name!r} needs the argument {arg.name!r}.", _explain_how(arg))
        elif arg.name not in bound and arg.default is not None:
            bound[arg.name] = arg.default
    return bound


def is_later(value: Any) -> bool:
    """Whether the value comes from the result of an earlier step."""
    return isinstance(value, dict) and "$result" in value


def _check(arg: Arg, name: str, value: Any, add_finding: AddFinding) -> Any:
    if is_later(value):
        return value
    try:
        refuse_non_finite(value)
        value = _read(arg, value)
        problem = find_flaw(arg, value)
    except ValueError as error:
        problem = str(error)
    if problem:
        add_finding(name, f"{_describe_name(arg, name)} {problem}.", _explain_how(arg))
    return value


def _describe_name(arg: Arg, name: str) -> str:
    return f"The argument {name!r}" + (f" ({arg.name})" if name != arg.name else "")


def _read(arg: Arg, value: Any) -> Any:
    """The value for a written text. Raises ValueError."""
    if arg.type in ("int", "float"):
        value = _with_unit(arg, value) if isinstance(value, str) else value
        return int(value) if arg.type == "int" and isinstance(value, float) and value.is_integer() else value
    if arg.type == "list" and isinstance(value, tuple):
        return list(value)
    if arg.type == "station" and isinstance(value, list):
        raise ValueError("must name a station; joint angles do not show which station it is")
    if arg.type in ("station", "file") and value == "" and arg.required:
        raise ValueError("is empty")
    return value


def _with_unit(arg: Arg, text: str) -> Any:
    """``"2 min"`` for an argument in seconds."""
    match = match_quantity(text)
    if not match:
        return text
    if not match[2]:
        return float(match[1])
    number, unit = float(match[1]), match[2]
    if unit == arg.unit or (unit in _TEMPERATURE and arg.unit in _TEMPERATURE):
        return number
    if unit in SECONDS and arg.unit in SECONDS:
        return number * SECONDS[unit] / SECONDS[arg.unit]
    takes = f"is in {arg.unit}" if unit_of(arg) else "has no unit"
    raise ValueError(f"{takes}, not in {unit!r}")


def _explain_how(arg: Arg) -> str:
    """The values that the argument takes, as a remedy."""
    return f"Write {describe_arg(arg)} for {arg.name!r}."
