"""SOLOSoft's protocol files (``.hso``), as far as what must not be sent can be told from them.

Text with carriage return and line feed: the plate at each of eight positions, a line each, then the
steps, each of which ends with a line ``!@#$``. Source: AD-SDL/hudson-liquidhandling,
src/liquidhandling/hudson/SoloSoft.py and docs/SoloSoft.md.
"""

from __future__ import annotations

POSITIONS, MOST_STEPS = 8, 69
"""At about 70 steps the program is known to crash when it opens the file."""
STEP_END = "!@#$"
STEPS = {
    *("GetTip", "ShuckTip", "Loop", "EndLoop", "Aspirate", "Dispense", "Prime", "Pause", "GetBottom"),
    *("SetSpeed", "MoveArm", "MovePlate", "OperateAccessory", "HitPicking"),
}


def wrong_in(text: str) -> str:
    """Why the program would not open it; empty if nothing is known against it."""
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
