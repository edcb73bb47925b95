"""Reads SOLOSoft's protocol files (``.hso``): checks them, counts tips, and finds dispensed volumes.

A file is text. Lines end with carriage return and line feed. The first eight lines name the plate at each
position. Then come the steps; each step ends with a line ``!@#$``. Source: AD-SDL/hudson-liquidhandling,
src/liquidhandling/hudson/SoloSoft.py and docs/SoloSoft.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from labos.node import Count
from labos_drivers._refusals import make_refusal

LARGEST = 1024 * 1024
POSITIONS, MOST_STEPS = 8, 69
"""At about 70 steps the program is known to crash when it opens the file."""
STEP_END = "!@#$"
STEPS = {
    *("GetTip", "ShuckTip", "Loop", "EndLoop", "Aspirate", "Dispense", "Prime", "Pause", "GetBottom"),
    *("SetSpeed", "MoveArm", "MovePlate", "OperateAccessory", "HitPicking"),
}


def read_protocol(driver: str, file: Path) -> str:
    """The text of a protocol. Raises DeviceError (effects ``none``) if there is no such file, if it is too
    large, or if the program would not open it."""
    why, text = "there is no such file", ""
    if file.is_file():
        data = file.read_bytes()
        text = data.decode("utf-8", "replace")
        why = f"it has {len(data)} bytes, more than {LARGEST}" if len(data) > LARGEST else find_flaw(text)
    if why:
        raise make_refusal(
            driver, f"{file.name} cannot be run: {why}", "Write it again with SOLOSoft, or split it."
        )
    return text


def find_flaw(text: str) -> str:
    """The reason why the program would not open a protocol; empty if no reason is found."""
    lines = text.splitlines()
    if text and "\r\n" not in text:
        return "its lines do not end with carriage return and line feed"
    ends = [number for number, line in enumerate(lines) if line.strip() == STEP_END]
    if len(lines) <= POSITIONS or not ends:
        return f"it has no {POSITIONS} positions and steps"
    if len(ends) > MOST_STEPS:
        return f"it has {len(ends)} steps, and the program crashes beyond {MOST_STEPS}"
    begins = [POSITIONS, *(number + 1 for number in ends[:-1])]
    unknown = [lines[number].strip() for number in begins if lines[number].strip() not in STEPS]
    if unknown:
        return f"{unknown[0]!r} is no step"
    if any(line.strip() for line in lines[ends[-1] + 1 :]):
        return "its last step has no end"
    return ""


TIPS = 3
"""The line of a ``GetTip`` that says how many: behind its name, the position and the disposal."""
REMEDY = "Write the numbers into its GetTip and Loop steps, as SOLOSoft does."


def count_used_tips(name: str, content: bytes, args: Mapping[str, Any]) -> Count:
    """The number of tips that the steps of a protocol get; tips in a loop count once for each round. The
    Count has a doubt if the number is not certain."""
    text = content.decode("utf-8", "replace")
    if why := find_flaw(text):
        return Count(0.0, why, REMEDY)
    tips, rounds, inside = 0.0, 1, False
    for step in _split_steps(text.splitlines()[POSITIONS:]):
        match step[0]:
            case "Loop":
                again = _parse_integer(step, 1)
                if again is None or inside:
                    return Count(tips, "how often it goes through a loop cannot be told", REMEDY)
                rounds, inside = again, True
            case "EndLoop":
                rounds, inside = 1, False
            case "GetTip":
                number = _parse_integer(step, TIPS)
                if number is None:
                    return Count(tips, "a step GetTip does not say how many tips it gets", REMEDY)
                tips += rounds * number
            case "HitPicking":
                return Count(tips, "how many tips HitPicking gets cannot be told", REMEDY)
    return Count(tips)


def _split_steps(lines: list[str]) -> Iterator[list[str]]:
    """Each step as a list of lines: its name, then its properties."""
    step: list[str] = []
    for line in lines:
        if line.strip() == STEP_END:
            yield step
            step = []
        else:
            step.append(line.strip())


def _parse_integer(step: list[str], number: int) -> int | None:
    """The line ``number`` of a step as an integer; None if it is missing or not an integer of 0 or more."""
    return int(step[number]) if len(step) > number and step[number].isdecimal() else None


ROWS, COLUMNS = "ABCDEFGH", 12


def find_dispensed(text: str, liquids: Mapping[str, str]) -> dict[str, dict[str, float]]:
    """The volumes that the steps of a protocol dispense (µL by liquid and well). ``liquids`` has the liquid
    at each position from which the steps aspirate; other positions are ignored."""
    found: dict[str, dict[str, float]] = {}
    liquid = ""
    for step in _split_steps(text.splitlines()[POSITIONS:]):
        if step[0] == "Aspirate":
            liquid = liquids.get(step[1], "") if len(step) > 1 else ""
        elif step[0] == "Dispense" and liquid:
            doses = found.setdefault(liquid, {})
            for well, ul in _read_matrix(step):
                doses[well] = doses.get(well, 0.0) + ul
    return found


def _read_matrix(step: list[str]) -> Iterator[tuple[str, float]]:
    """The wells and volumes (µL) above 0 in a step. A step has eight lines of twelve numbers."""
    rows = [line.split(",") for line in step if line.count(",") == COLUMNS - 1]
    for row, volumes in zip(ROWS, rows, strict=False):
        for column, volume in enumerate(volumes, 1):
            if float(volume) > 0:
                yield f"{row}{column}", float(volume)
