"""The serial protocol of the STX controller. It is a PLC: a host reads and writes its relays and words.

9600 baud, 8 data bits, even parity, 1 stop bit. A question ends with a carriage return, an answer with a
carriage return and a line feed. Each question has one answer. The letters ``CR`` open the connection (answer
``CC``). Before that, the controller answers every question with ``E1``.

Sources: PyLabRobot/pylabrobot, pylabrobot/legacy/storage/liconic; the PyPI package open-liconic-stx
0.1.0; AD-SDL/liconic_module.
"""

from __future__ import annotations

BAUDRATE = 9600
ASK_END, ANSWER_END = b"\r", b"\r\n"

INITIALISE, RESET = 1801, 1900
READY, ERROR = 1915, 1814
END_OF_ACCESS, IMPORT, EXPORT, SHOVEL_OUT = 1903, 1904, 1905, 1906
SHAKING = 1913
ON_SHOVEL, ON_STATION = 1812, 1813

STACKER, SLOT, SHAKER, ERROR_CODE = 0, 5, 39, 200
TEMPERATURE, TEMPERATURE_NOW = 890, 982
HUMIDITY, HUMIDITY_NOW = 893, 983

REFUSALS = {
    "E0": "it has no such address",
    "E1": "it does not take this command; the conversation is not open",
    "E2": "the program of its controller is lost",
    "E3": "its hardware is at fault",
    "E4": "the address is write-protected",
    "E5": "it is not authorised",
}

MEANINGS = {
    1: "a general error, or a time-out",
    7: "the gate does not open",
    8: "the gate does not close",
    9: "the lift is not where it should be",
    10: "somebody turned the carousel by hand, or there is no such stacker",
    11: "the slot of the stacker is out of reach",
    12: "there is no such level",
    13: "a plate stands on the transfer station, or was not loaded as expected",
    14: "the lift or the start failed",
    15: "a plate is on the shovel already",
    16: "no plate is on the shovel",
    17: "no recovery",
}
"""What the word 200 says where the two public tables can be read together; they disagree, by
generation of the firmware."""


def meaning_of(code: int) -> str:
    """The meaning of an error code. Codes from 100 on are a kind of motion (the hundreds) and the step in
    which it failed; smaller codes are other faults."""
    phase = {1: "importing", 2: "exporting", 3: "removing", 4: "reading a barcode", 5: "placing"}
    if code in MEANINGS:
        return MEANINGS[code]
    return f"while {phase[code // 100]}, step {code % 100}" if code // 100 in phase else "an unknown error"
