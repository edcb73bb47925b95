"""Finds the program for an action in the workcell file, among those that were taught on the controller."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from labos.node import Setup
from labos_drivers._refusals import make_refusal
from labos_drivers._simulation import place_of
from labos_drivers.ur.rtde import INPUTS

PROGRAM = re.compile(r"[\w /.\-]{1,200}\.urp")


def check_program(name: str, program: str) -> str:
    """The name of a program. Raises DeviceError for other text, which could contain a second command."""
    if not PROGRAM.fullmatch(program):
        raise make_refusal(name, f"{program[:60]!r} is no name of a program", "It ends with .urp.")
    return program


def read_input(setup: Setup, config: Mapping[str, Any], key: str, where: str) -> int:
    """The number of the digital input under a key. Raises DeviceError for a number that no controller has:
    such an input would always be off."""
    number = config.get(key)
    if isinstance(number, int) and not isinstance(number, bool) and 0 <= number < INPUTS:
        return number
    raise make_refusal(
        setup.name,
        f"{number!r} is no digital input, of which there are 0 to {INPUTS - 1}",
        f"Correct `{key}` in `{where}:` of the module's `config:`.",
    )


def find_carrying_program(setup: Setup, source: str, target: str, named: str = "") -> str:
    """The program that carries labware from the source to the target. If the workcell file has none, it is
    the one that is ``named``. Raises DeviceError if there is neither, or if the two differ."""
    way = place_of(setup, source), place_of(setup, target)
    for entry in setup.config.get("programs") or ():
        ends = entry.get("source", ""), entry.get("target", "")
        if "" not in ends and tuple(place_of(setup, end) for end in ends) == way:
            program = str(entry.get("program", ""))
            if named not in ("", program):
                raise make_refusal(
                    setup.name,
                    f"the program from {source} to {target} is {program}, not {named}",
                    "Correct the workflow, or `programs:` of the module.",
                )
            return check_program(setup.name, program)
    if not named:
        raise make_refusal(
            setup.name,
            f"it has no program that goes from {source} to {target}",
            "Teach one, and write it under `programs:` of the module's `config:`.",
        )
    return check_program(setup.name, named)


def find_pendant_program(setup: Setup, action: str, args: Mapping[str, str]) -> str:
    """The program of an action of the pendant drop. Raises DeviceError if the workcell file has none for
    these arguments."""
    configured: Any = (setup.config.get("pendant") or {}).get(action)
    entries = [{"program": configured}] if isinstance(configured, str) else configured or ()
    for entry in entries:
        if all(_is_same(setup, name, value, str(entry.get(name, ""))) for name, value in args.items()):
            return check_program(setup.name, str(entry.get("program", "")))
    what = ", ".join(f"{name} {value}" for name, value in args.items())
    raise make_refusal(
        setup.name,
        f"it has no program for {action}{f' with {what}' if what else ''}",
        "Teach one, and write it under `pendant:` of the module's `config:`.",
    )


def _is_same(setup: Setup, name: str, one: str, other: str) -> bool:
    if name == "plate" and other:
        return place_of(setup, one) == place_of(setup, other)
    return one == other
