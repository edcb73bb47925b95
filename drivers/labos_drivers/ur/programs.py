"""Which of the programs that were taught on the controller does what, as the workcell file says."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from labos.errors import DeviceError
from labos.node import Setup
from labos_drivers._simulation import place_of
from labos_drivers.ur.rtde import INPUTS

PROGRAM = re.compile(r"[\w /.\-]{1,200}\.urp")


def checked(name: str, program: str) -> str:
    """Raises DeviceError for what would be more than the name of a program."""
    if not PROGRAM.fullmatch(program):
        raise DeviceError(
            f"{name}: {program[:60]!r} is no name of a program.", effects="none", remedy="It ends with .urp."
        )
    return program


def input_of(setup: Setup, told: Mapping[str, Any], key: str, where: str) -> int:
    """The digital input that is named below a key. Raises DeviceError for one that no controller has: it
    would tell for ever that nothing is there."""
    number = told.get(key)
    if isinstance(number, int) and not isinstance(number, bool) and 0 <= number < INPUTS:
        return number
    raise DeviceError(
        f"{setup.name}: {number!r} is no digital input, of which there are 0 to {INPUTS - 1}.",
        effects="none",
        remedy=f"Correct `{key}` in `{where}:` of the module's `config:`.",
    )


def carrying(setup: Setup, source: str, target: str, named: str = "") -> str:
    """That which carries labware this way. Raises DeviceError if the workcell file knows none, or another
    one than is named."""
    way = place_of(setup, source), place_of(setup, target)
    for entry in setup.config.get("programs") or ():
        ends = entry.get("source", ""), entry.get("target", "")
        if "" not in ends and tuple(place_of(setup, end) for end in ends) == way:
            program = str(entry.get("program", ""))
            if named not in ("", program):
                raise DeviceError(
                    f"{setup.name}: the program from {source} to {target} is {program}, not {named}.",
                    effects="none",
                    remedy="Correct the workflow, or `programs:` of the module.",
                )
            return checked(setup.name, program)
    if not named:
        raise DeviceError(
            f"{setup.name}: it has no program that goes from {source} to {target}.",
            effects="none",
            remedy="Teach one, and write it under `programs:` of the module's `config:`.",
        )
    return checked(setup.name, named)


def pendant(setup: Setup, action: str, args: Mapping[str, str]) -> str:
    """That of an action of the pendant drop. Raises DeviceError if the workcell file knows none for these
    arguments."""
    told: Any = (setup.config.get("pendant") or {}).get(action)
    entries = [{"program": told}] if isinstance(told, str) else told or ()
    for entry in entries:
        if all(_same(setup, name, value, str(entry.get(name, ""))) for name, value in args.items()):
            return checked(setup.name, str(entry.get("program", "")))
    what = ", ".join(f"{name} {value}" for name, value in args.items())
    raise DeviceError(
        f"{setup.name}: it has no program for {action}{f' with {what}' if what else ''}.",
        effects="none",
        remedy="Teach one, and write it under `pendant:` of the module's `config:`.",
    )


def _same(setup: Setup, name: str, one: str, other: str) -> bool:
    if name == "plate" and other:
        return place_of(setup, one) == place_of(setup, other)
    return one == other
