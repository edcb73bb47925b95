"""SOLOSoft's protocol files (``.hso``), as far as what must not be sent can be told from them.

Text with carriage return and line feed: the plate at each of eight positions, a line each, then the
steps; each ends with a line ``!@#$``. Source: AD-SDL/hudson-liquidhandling,
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
    """The text of a protocol. Raises DeviceError for one that the program would not take: nothing has
    moved."""
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
    """Why the program would not open a protocol; empty if nothing is known against it."""
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
    """The tips that the steps of a protocol get; those in a loop as often as it says."""
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
    """Each step with its properties, a line each."""
    step: list[str] = []
    for line in lines:
        if line.strip() == STEP_END:
            yield step
            step = []
        else:
            step.append(line.strip())


def _parse_integer(step: list[str], number: int) -> int | None:
    """A property that is a whole number from 0; None if it is not."""
    return int(step[number]) if len(step) > number and step[number].isdecimal() else None


ROWS, COLUMNS = "ABCDEFGH", 12


def find_dispensed(text: str, liquids: Mapping[str, str]) -> dict[str, dict[str, float]]:
    """The volumes that the steps of a protocol put into wells (µL by liquid and well); ``liquids`` has the
    liquid at each position that it takes from."""
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
    """The volumes that a step has for single wells: eight lines of twelve numbers."""
    rows = [line.split(",") for line in step if line.count(",") == COLUMNS - 1]
    for row, volumes in zip(ROWS, rows, strict=False):
        for column, volume in enumerate(volumes, 1):
            if float(volume) > 0:
                yield f"{row}{column}", float(volume)
