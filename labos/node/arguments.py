"""Checks the arguments of a call against the declarations of an action.

Nothing is converted silently, except an integer to a float. The allowed values are defined in
``labos.core.arguments``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from labos.core.arguments import describe_arg, find_flaw, list_names, shorten
from labos.core.model import ActionSpec
from labos.errors import ActionInvalid


class ArgumentProblem(msgspec.Struct, frozen=True):
    """The fault of one argument; ``argument`` is the name that the caller wrote."""

    argument: str
    message: str


def list_problems(spec: ActionSpec, args: Mapping[str, Any]) -> list[ArgumentProblem]:
    """All faults of a call, in the order of declaration; unknown names last."""
    found: list[ArgumentProblem] = []
    meant = list_names(spec)
    for arg in spec.args:
        written = [name for name in args if meant.get(name) is arg]
        if len(written) > 1:
            found.append(ArgumentProblem(written[1], f"is given twice, as {', '.join(written)}"))
        elif not written:
            if arg.required:
                found.append(ArgumentProblem(arg.name, f"is missing: {describe_arg(arg)}"))
        elif find_flaw(arg, args[written[0]]):
            found.append(
                ArgumentProblem(written[0], f"must be {describe_arg(arg)}, not {shorten(args[written[0]])}")
            )
    known = ", ".join(arg.name for arg in spec.args)
    takes = f"takes {known}" if known else "takes no arguments"
    found.extend(
        ArgumentProblem(name, f"is not known: {spec.name} {takes}") for name in args if name not in meant
    )
    return found


def bind(spec: ActionSpec, args: Mapping[str, Any]) -> dict[str, Any]:
    """The call's arguments under their declared names; defaults are left out.

    Raises ActionInvalid with one sentence about the first fault.
    """
    for problem in list_problems(spec, args):
        raise ActionInvalid(f"{spec.name}: argument {problem.argument!r} {problem.message}.")
    meant = list_names(spec)
    return {
        meant[name].name: float(value) if meant[name].type == "float" and value is not None else value
        for name, value in args.items()
    }
