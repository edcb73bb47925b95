"""The pipette's protocol: the DT protocol of OEM pumps.

The line is serial (9600 baud, 8N1), or TCP port 54321 for the bytes of the arm's tool connector. A message
is ``/``, the pump's address, commands and a carriage return; ``R`` at the end of the commands runs them. A
reply is ``/0``, a status character, data, 0x03, carriage return and line feed. In the status, bit 5 means
that the pump is ready. The low four bits are an error code.

Sources: AD-SDL/ur_module, src/ur_interface/ur_tools/pipette_driver.py (Z pump); libairz of the CDXBot (Air-Z:
``Z``, ``E0``, steps); TriContinent C24000 product manual, Cavro XP 3000 manual (errors).
"""

from __future__ import annotations

import re
from typing import NamedTuple

from labos.link import BadFrame

BAUDRATE, TOOL_PORT = 9600, 54321
ADDRESS = b"1"
ETX = 0x03
LIMIT = 512
PADDING = b"\xff\r\n"
READY, ALWAYS = 0x20, 0x40

NOT_INITIALISED, OVERLOAD, TIP_LOST, OVERFLOW = 7, 9, 11, 15
MEANINGS = {
    1: "it could not be initialised",
    2: "it does not know the command",
    3: "it does not take the value",
    6: "its memory is damaged",
    NOT_INITIALISED: "it is not initialised",
    8: "its bus failed",
    OVERLOAD: "its plunger does not move",
    TIP_LOST: "it has lost its tip",
    OVERFLOW: "it was told too much at once",
}


class Kind(NamedTuple):
    """What differs between pumps: the command that initialises, the command that ejects a tip (empty: the
    pump cannot), the full stroke of the plunger in steps, and its volume in µL."""

    initialise: str
    eject: str
    steps: int
    volume_ul: float


KINDS = {
    "z_pump": Kind("z1600A0A10z0", "", 1600, 200.0),
    "air_z": Kind("Z", "E0", 2857, 1000.0),
}
"""The Air-Z goes 3143 steps, which are 1100 µL; a tip holds 1000."""

SLOWEST_STEPS_S, FASTEST_STEPS_S = 5, 6000


class Answer(NamedTuple):
    ready: bool
    error: int
    data: str


class Frames:
    """The framing: packs commands to one pump, and takes its replies."""

    def pack(self, message: bytes) -> bytes:
        return b"/" + ADDRESS + message + b"\r"

    def take(self, buffer: bytearray) -> bytes | None:
        del buffer[: len(buffer) - len(buffer.lstrip(PADDING))]
        end = buffer.find(ETX)
        if end < 0:
            if len(buffer) > LIMIT:
                buffer.clear()
                raise BadFrame(f"{LIMIT} bytes have no end")
            return None
        message = bytes(buffer[:end])
        del buffer[: end + 1]
        if not re.fullmatch(rb"/0[@-o][ -~]*", message):
            raise BadFrame(f"{message[:60]!r} is no answer of a pump")
        return message[2:]


def read(message: bytes) -> Answer:
    return Answer(bool(message[0] & READY), message[0] & 0x0F, message[1:].decode("ascii"))


def write(ready: bool, error: int, data: str = "") -> bytes:
    """The bytes of a reply, as the pump sends it."""
    status = bytes((ALWAYS | READY * ready | error,))
    return b"\xff/0" + status + data.encode("ascii") + bytes((ETX,)) + b"\r\n"
