"""Real-time data of a UR controller (RTDE), port 30004: its packages, and the data that the driver requests.

A package has a size (two bytes; it includes the header of three bytes), a type (a letter) and a content. All
numbers are big-endian. The client asks for version 2 and names the outputs that it wants (a recipe). The
controller answers with their types. Then the client starts and pauses the stream.

Sources: Universal Robots, *Real-Time Data Exchange (RTDE) Guide*; UniversalRobots/
Universal_Robots_Client_Library, include/ur_client_library/rtde; the numbers of ``runtime_state`` from the
maker's forum and the same library.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import msgspec

from labos.link import BadFrame

PORT, VERSION = 30004, 2
HEADER = 3
ASK_VERSION, ASK_CONTROLLER, TEXT, DATA, OUTPUTS, START, PAUSE = b"V", b"v", b"M", b"U", b"O", b"S", b"P"
NOT_FOUND = "NOT_FOUND"

FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}

STOPPED, PLAYING, PAUSED = 1, 2, 4
"""Of ``runtime_state``; 0 stopping, 3 pausing, 5 resuming."""

MODES = {"POWER_OFF": 3, "POWER_ON": 4, "IDLE": 5, "BACKDRIVE": 6, "RUNNING": 7}
SAFETY = {
    "NORMAL": 1,
    "REDUCED": 2,
    "PROTECTIVE_STOP": 3,
    "RECOVERY": 4,
    "SAFEGUARD_STOP": 5,
    "SYSTEM_EMERGENCY_STOP": 6,
    "ROBOT_EMERGENCY_STOP": 7,
    "VIOLATION": 8,
    "FAULT": 9,
}
"""``robot_mode`` and ``safety_mode``, by the dashboard's words for them."""

TOOL_INPUTS = 16
"""The first of the tool's two inputs in ``actual_digital_input_bits``, after 8 standard ones and 8 that can
be configured."""

INPUTS = TOOL_INPUTS + 2
"""So many digital inputs a controller has, counted from 0 (RTDE guide; e-Series: 8 + 8 + 2)."""

STILL_RAD_S = 0.001
"""A joint that turns more slowly than this stands still."""


class Robot(msgspec.Struct, frozen=True):
    """The content of one data package. The names are those of the recipe."""

    actual_qd: tuple[float, ...]
    runtime_state: int
    actual_digital_input_bits: int

    @property
    def stands_still(self) -> bool:
        return all(abs(speed) < STILL_RAD_S for speed in self.actual_qd)

    def input(self, number: int) -> bool:
        """Whether a digital input is on."""
        return bool(self.actual_digital_input_bits >> number & 1)


RECIPE = Robot.__struct_fields__
TYPES = ("VECTOR6D", "UINT32", "UINT64")
"""Of the recipe, as the guide gives them."""


class Packages:
    """The framing of packages: a message is the type and the content of a package, without the size."""

    def pack(self, message: bytes) -> bytes:
        return struct.pack(">H", len(message) + HEADER - 1) + message

    def take(self, buffer: bytearray) -> bytes | None:
        if len(buffer) < HEADER:
            return None
        (size,) = struct.unpack_from(">H", buffer)
        if size < HEADER:
            bad = bytes(buffer)
            buffer.clear()
            raise BadFrame(f"a package of {size} bytes: {bad[:60]!r}")
        if len(buffer) < size:
            return None
        message = bytes(buffer[2:size])
        del buffer[:size]
        return message


def request_outputs(names: Iterable[str], frequency_hz: float) -> bytes:
    """The message that requests outputs, ``frequency_hz`` times per second."""
    return OUTPUTS + struct.pack(">d", frequency_hz) + ",".join(names).encode("ascii")


def parse_outputs(content: bytes) -> tuple[float, list[str]]:
    """Frequency (Hz) and names in the content of a message that requests outputs. Raises ValueError."""
    if len(content) < 8:
        raise ValueError("no frequency")
    names = content[8:].decode("ascii").split(",")
    return struct.unpack_from(">d", content)[0], [name for name in names if name]


def pack_values(recipe: int, types: Sequence[str], values: Iterable[Any]) -> bytes:
    """The message of a data package, with the values of the outputs in a recipe."""
    flat: list[Any] = []
    for value in values:
        flat += value if isinstance(value, Sequence) else (value,)
    return DATA + struct.pack(f">B{_format(types)}", recipe, *flat)


def unpack_robot(recipe: int, content: bytes) -> Robot:
    """The state in the content of a data package. Raises ValueError if its size or recipe is another one."""
    layout = f">B{_format(TYPES)}"
    if len(content) != struct.calcsize(layout):
        raise ValueError(f"a data package of {len(content)} bytes")
    number, *flat = struct.unpack(layout, content)
    if number != recipe:
        raise ValueError(f"a package of recipe {number}")
    return Robot(tuple(flat[:6]), *flat[6:])


def types_of(known: Mapping[str, str], names: Iterable[str]) -> list[str]:
    """The types of the requested outputs, from a controller with the ``known`` ones; NOT_FOUND for others."""
    return [known.get(name, NOT_FOUND) for name in names]


def _format(types: Iterable[str]) -> str:
    return "".join(FORMATS[kind] for kind in types)
