"""Barty's pumps on their wire: the pins of a Raspberry Pi, by the socket of its pigpio daemon (TCP 8888).

A question is four little-endian words (command, p1, p2, length of what follows) and what follows; an
answer repeats the first three, with the result (negative: an error) as the fourth. ``PROCP`` alone is
answered with as many further bytes as its result says: a status and ten parameters.

A dose is a script that the daemon keeps and runs by itself, so that a pump stops on time even if the client
that started it has died. A script marks in its parameters that it has begun, whose it is, and that it has
ended.

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
    """The pins of one motor's bridge, by Broadcom number."""

    forward: int
    backward: int
    enable: int


PINS = (Pins(22, 27, 17), Pins(23, 24, 25), Pins(9, 11, 10), Pins(8, 7, 12))
"""Pins 15, 13, 11; 16, 18, 22; 21, 23, 19; 24, 26, 32 of the header."""


class Framing:
    """Packed words both ways."""

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
    """The script that runs some pumps at the same time for so long (ms). They start and stop a few
    instructions of the daemon apart."""
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
