"""The protocol of Barty's pumps. The pigpio daemon of a Raspberry Pi sets its pins, over a socket (TCP 8888).

A command has four little-endian words (command, p1, p2, length of the data) and then the data. A reply
repeats the first three words. Its fourth word is the result (negative: an error). Only the reply to ``PROCP``
has data: a status and ten parameters. Its result is their length in bytes.

A dose is a script that the daemon stores and runs by itself. So a pump stops on time even if the client that
started it has failed. A script shows in its parameters that it has begun, the mark of its dose, and that it
has ended.

Sources: joan2937/pigpio, pigpio.py, command.c, pigpio.h (commands, scripts, limits); AD-SDL/barty_module,
src/barty_interface.py (pins, directions, rate).
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from labos.link import BadFrame

PORT = 8888
READ, WRITE, PIGPV = 3, 4, 26
PROC, PROCD, PROCR, PROCS, PROCP = 38, 39, 40, 41, 45
HIGHEST_COMMAND = 117
INITING, HALTED, RUNNING, WAITING, FAILED = range(5)
NO_ROOM, ROOM = -57, 32
"""The daemon keeps so many scripts."""
ENDED, BEGUN, OWNER = 0, 1, 9
"""Parameters of a script, and what is told in them."""

LONGEST_DELAY_MS = 60_000
HEADER = struct.Struct("<IIIi")
STATUS = struct.Struct("<11i")

ML_PER_S = 1.427
"""At full speed; open loop, so that tubes have to be calibrated as they wear."""


class Pins(NamedTuple):
    """The pins of the bridge of one motor, by their Broadcom numbers."""

    forward: int
    backward: int
    enable: int


PINS = (Pins(22, 27, 17), Pins(23, 24, 25), Pins(9, 11, 10), Pins(8, 7, 12))
"""Pins 15, 13, 11; 16, 18, 22; 21, 23, 19; 24, 26, 32 of the header."""


class Framing:
    """Packed words in both directions. The header of a reply determines its length."""

    def pack(self, message: bytes) -> bytes:
        return message

    def take(self, buffer: bytearray) -> bytes | None:
        if len(buffer) < HEADER.size:
            return None
        command, _, _, result = HEADER.unpack_from(buffer)
        more = max(result, 0) if command == PROCP else 0
        if command > HIGHEST_COMMAND or more > STATUS.size:
            raise BadFrame(f"no command {command} is answered so: {_cut(buffer, len(buffer))!r}")
        whole = HEADER.size + more
        return _cut(buffer, whole) if len(buffer) >= whole else None


def make_command(command: int, p1: int = 0, p2: int = 0, more: bytes = b"") -> bytes:
    return HEADER.pack(command, p1, p2, len(more)) + more


def write_script(pumps: list[int], milliseconds: int, owner: int, *, fill: bool) -> str:
    """The script that runs some pumps at the same time, for this duration (ms). Their starts and their stops
    are a few instructions of the daemon apart."""
    commands = [f"ld p9 {owner} ld p1 1"]
    for pump in pumps:
        pins = PINS[pump]
        commands += [f"m {pin} w" for pin in pins]
        commands += [f"w {pins.enable} 0 w {pins.forward} {int(not fill)} w {pins.backward} {int(fill)}"]
    commands += [f"w {PINS[pump].enable} 1" for pump in pumps]
    while milliseconds > 0:
        commands += [f"mils {min(milliseconds, LONGEST_DELAY_MS)}"]
        milliseconds -= LONGEST_DELAY_MS
    commands += [f"w {PINS[pump].enable} 0" for pump in pumps]
    for pump in pumps:
        commands += [f"w {PINS[pump].forward} 0 w {PINS[pump].backward} 0"]
    return " ".join([*commands, "ld p0 1"])


def _cut(buffer: bytearray, size: int) -> bytes:
    taken = bytes(buffer[:size])
    del buffer[:size]
    return taken
