"""The protocol of the incubator: commands are binary frames with a check sum, answers have none.

19200 baud, 8N1, DTR and RTS off. A command is its length (without this byte), 0x30 + id, 0xC0 + the length of
the text, the text and a check sum. The text is ``T0``, the floor, three letters and arguments. An answer
begins with parts of 0xB0 + id and text, if it has text. It ends with 0xB0 + id, 0x20 + error code, 0x60.

Sources: PyLabRobot/pylabrobot, pylabrobot/storage/inheco/incubator_shaker_backend.py;
AD-SDL/inheco_incubator_module.
"""

from __future__ import annotations

from labos.link import BadFrame

BAUDRATE = 19200
USUAL_ID = 2
END = 0x60
LIMIT = 256

OK, RESET, BAD_COMMAND, BAD_OPERAND, NOT_INITIALISED = 0, 1, 2, 3, 7
NOT_EXECUTABLE, BETWEEN, LABWARE = 8, 9, 10

MEANINGS = {
    RESET: "it was reset, or had no power for a moment",
    BAD_COMMAND: "it does not know the command",
    BAD_OPERAND: "it does not accept the value",
    4: "it did not understand the command",
    6: "its device does not answer",
    NOT_INITIALISED: "it is not initialised",
    NOT_EXECUTABLE: "it cannot do that now",
    BETWEEN: "its drawer is neither open nor closed",
    LABWARE: "it finds a plate where none should be, or none where one should be",
    13: "its drawer is not quite closed",
    14: "there is no such floor",
    15: "a part of it does not answer",
}

MP, MP_SHAKER, DWP, DWP_SHAKER = "0", "1", "2", "3"
NO_PLATE, PLATE = "0", "1"
"""What ``RLW`` says; it does not know while the drawer is open (8), nor after a reset (7)."""

SHAKES, RUNS_DOWN = "1", "2"
"""What ``RSE`` says."""


def check_sum(data: bytes) -> int:
    """The check sum: eight bits, start value 0xA1, least significant bit first, feedback 0x18."""
    register = 0xA1
    for byte in data:
        for bit in range(8):
            feeds = (byte >> bit ^ register) & 1
            register = ((register ^ 0x18) >> 1 | 0x80) if feeds else register >> 1
    return register


def make_command(command: str, floor: int, device: int = USUAL_ID) -> bytes:
    """A command as the host sends it."""
    text = f"T0{floor}{command}".encode("ascii")
    head = bytes((len(text) + 3, 0x30 + device, 0xC0 + len(text)))
    return head + text + bytes((check_sum(head + text),))


def make_answer(text: str, error: int, device: int = USUAL_ID) -> bytes:
    """An answer as the device sends it."""
    head = bytes((0xB0 + device,))
    return (head + text.encode("ascii") if text else b"") + head + bytes((0x20 + error, END))


class Answers:
    """The framing for answers of one stack. Each is taken as a byte with the error code, and the text."""

    def __init__(self, device: int) -> None:
        self._head = 0xB0 + device

    def pack(self, message: bytes) -> bytes:
        return message

    def take(self, buffer: bytearray) -> bytes | None:
        if buffer and buffer[0] != self._head:
            bad = bytes(buffer)
            buffer.clear()
            raise BadFrame(f"it does not have the start of an answer: {bad[:60]!r}")
        for at in range(len(buffer) - 2):
            head, error, end = buffer[at : at + 3]
            if head == self._head and error & 0xF0 == 0x20 and end == END:
                text = bytes(buffer[:at]).replace(bytes((self._head,)), b"")
                del buffer[: at + 3]
                return bytes((error & 0x0F,)) + text
        if len(buffer) > LIMIT:
            buffer.clear()
            raise BadFrame(f"{LIMIT} bytes without a terminator")
        return None
