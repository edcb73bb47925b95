"""The protocol of the XPeel: lines, and the meanings of its error codes.

9600 baud, 8 data bits, no parity, 1 stop bit. Lines are lower-case ASCII; they begin with ``*`` and end with
carriage return and line feed. A motion is answered with ``*ack`` at once and with ``*ready:E1,E2,E3`` at its
end. The three codes are the errors of the motion, in order of occurrence. ``*stat`` reports them again until
the next motion.

Sources: AD-SDL/brooks_xpeel_module; PyLabRobot/pylabrobot, pylabrobot/azenta/xpeel.py; the XPeel User
Manual 440140 (pages 45 to 56), as other public drivers quote it.
"""

from __future__ import annotations

import re

import msgspec

from labos.node.protocol import EffectsDone

BAUDRATE = 9600
READY_LINE = re.compile(rb"\*ready:(\d+),(\d+),(\d+)")
END = b"\r\n"
UNKNOWN_TAPE = 99
ADHERE_S = (2.5, 5.0, 7.5, 10.0)
FEW = 30
"""Seals below which the device warns."""


class Code(msgspec.Struct, frozen=True):
    """One error code. ``effects`` are the known effects of the motion. A ``warning`` is not a failure."""

    meaning: str
    remedy: str = ""
    effects: EffectsDone = "unknown"
    warning: bool = False


SEAL = 4
NO_PLATE = 6
OUT_OF_TAPE = 7
CODES = {
    1: Code("the conveyor motor stalled", "Take out what blocks it, then reset the module."),
    2: Code("the elevator motor stalled", "Take out what blocks it, then reset the module."),
    3: Code("the take-up spool stalled", "Check the spool and the path of the tape, then reset the module."),
    SEAL: Code("the seal was not removed", "Peel slower or press longer, or peel by hand.", "partial"),
    5: Code("illegal command", "Check the version of its firmware.", "none"),
    NO_PLATE: Code("no plate found", "Look where the plate is.", "none"),
    OUT_OF_TAPE: Code("out of tape, or the tape broke", "Put tape in and say so: labos replenish."),
    8: Code("the parameters were not saved", "Choose another parameter set."),
    9: Code("somebody pressed the stop button", "Ask them, then reset the module."),
    10: Code("the seal sensor is unplugged or broken", "Have it repaired."),
    20: Code("fewer than 30 seals are left on the tape", warning=True),
    21: Code("there is room for fewer than 30 seals on the take-up spool", warning=True),
    51: Code("emergency stop: the cover is open", "Close the cover, then reset the module."),
    52: Code("a fault of its circuits", "Switch it off, and have it repaired."),
}


def parse_codes(line: bytes) -> tuple[int, ...]:
    """The codes of ``*ready:04,00,00``, without the zeros. Raises ValueError."""
    found = READY_LINE.fullmatch(line)
    if found is None:
        raise ValueError(f"{line!r} is no ready line")
    return tuple(code for code in map(int, found.groups()) if code)
