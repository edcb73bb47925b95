"""The drive profile CiA 402 (IEC 61800-7-201): objects, states, modes and error codes.

Sources: the object dictionaries and error tables that makers of such drives publish, for example maxon for
the EPOS4. The state machine is that of the Python package canopen 2.4, ``canopen.profiles.p402``.
"""

from __future__ import annotations

from enum import Enum

DEVICE_TYPE, ERROR_REGISTER, IDENTITY = 0x1000, 0x1001, 0x1018
PROFILE = 402
"""The lower half of the device type."""

ERROR_CODE = 0x603F
CONTROL, STATUS = 0x6040, 0x6041
MODE, MODE_NOW = 0x6060, 0x6061
POSITION_NOW, VELOCITY_NOW = 0x6064, 0x606C
POSITION_WINDOW = 0x6067
TARGET = 0x607A
HOME_OFFSET = 0x607C
LIMITS, LOWEST, HIGHEST = 0x607D, 1, 2
SPEED, ACCELERATION, DECELERATION = 0x6081, 0x6083, 0x6084
HOMING_METHOD = 0x6098
HOMING_SPEEDS, SWITCH_SPEED, ZERO_SPEED = 0x6099, 1, 2
HOMING_ACCELERATION = 0x609A
SUPPORTED = 0x6502

PROFILE_POSITION, HOMING = 1, 6
"""The modes in which ``REACHED`` says that the drive stands still. In one that holds a speed it says that the
speed is reached."""

DISABLE_VOLTAGE, QUICK_STOP, SHUT_DOWN, SWITCH_ON, ENABLE = 0x00, 0x02, 0x06, 0x07, 0x0F
START, AT_ONCE = 0x10, 0x20
"""Bits of the controlword: a new set-point (or the start of homing); in the place of the one before."""
RESET_FAULT = 0x80

REACHED, LIMITED, ACKNOWLEDGED, ATTAINED, FAILED = 1 << 10, 1 << 11, 1 << 12, 1 << 12, 1 << 13
"""Bits of the statusword: target reached; limit active; set-point taken (profile position); homing
attained (homing); following error, or homing error."""


class State(Enum):
    """The states of the drive. Each has a mask for the statusword, and the bits under the mask."""

    NOT_READY = (0x4F, 0x00)
    DISABLED = (0x4F, 0x40)
    READY = (0x6F, 0x21)
    SWITCHED_ON = (0x6F, 0x23)
    ENABLED = (0x6F, 0x27)
    QUICK_STOP = (0x6F, 0x07)
    REACTING = (0x4F, 0x0F)
    FAULT = (0x4F, 0x08)


def state_of(status: int) -> State:
    """The state in a statusword. Raises ValueError if it contains no state."""
    for state in State:
        mask, bits = state.value
        if status & mask == bits:
            return state
    raise ValueError(f"the statusword {status:04X} is no state of CiA 402")


NEXT = {State.DISABLED: SHUT_DOWN, State.READY: SWITCH_ON, State.SWITCHED_ON: ENABLE}
"""The controlword that leads one state nearer to ENABLED."""

CHECK_LOAD = "Look for what is in its way, then reset the module."
CHECK_SUPPLY = "Check its supply, then reset the module."
LET_COOL = "Let it cool down and look why it is hot, then reset the module."
CHECK_SENSOR = "Check the cable of its encoder, then reset the module."
CHECK_CAN = "Check the CAN cable and its termination, then reset the module."

ERRORS = {
    0x2310: ("its current is too high", CHECK_LOAD),
    0x2320: ("its output is short-circuited", "Check the motor and its cable, then reset the module."),
    0x3210: ("its supply voltage is too high", CHECK_SUPPLY),
    0x3220: ("its supply voltage is too low", CHECK_SUPPLY),
    0x4210: ("it is too hot", LET_COOL),
    0x4310: ("it is too hot", LET_COOL),
    0x5113: ("the supply of its electronics is too low", CHECK_SUPPLY),
    0x6320: ("one of its parameters is wrong", "Compare its parameters with its manual."),
    0x7121: ("its motor is blocked", CHECK_LOAD),
    0x7305: ("its encoder failed", CHECK_SENSOR),
    0x7320: ("its position sensor failed", CHECK_SENSOR),
    0x8110: ("messages on the CAN bus were lost", CHECK_CAN),
    0x8120: ("the CAN bus is disturbed", CHECK_CAN),
    0x8130: ("it missed a heartbeat on the CAN bus", CHECK_CAN),
    0x8611: ("it could not follow (following error)", CHECK_LOAD),
    0x8612: ("it came to the end of its range", CHECK_LOAD),
}

CLASSES = {
    0x2: ("its current is wrong", CHECK_LOAD),
    0x3: ("its voltage is wrong", CHECK_SUPPLY),
    0x4: ("its temperature is wrong", LET_COOL),
    0x5: ("its hardware is at fault", "Look its code up in the manual."),
    0x6: ("its software is at fault", "Look its code up in the manual."),
    0x7: ("a part of it is at fault", "Look its code up in the manual."),
    0x8: ("what watches over it has stopped it", "Look its code up in the manual."),
    0x9: ("an error outside of it", "Look its code up in the manual."),
}
"""By the first digit."""


def meaning_of(code: int) -> tuple[str, str]:
    """The meaning of an error code, and the remedy."""
    unknown = ("an error of its maker's own", "Look its code up in the manual, then reset the module.")
    return ERRORS.get(code) or CLASSES.get(code >> 12) or unknown
