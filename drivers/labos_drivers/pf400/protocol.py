"""The protocol of the PreciseFlex 400: the lines of its TCP command server (TCS), and their meaning.

Port 10100 is robot 1. A command ends with a line feed, a reply with carriage return and line feed. A reply
has a code (0 done, 1 done with a warning, negative refused or failed), a space, and data. Each command has
one reply, in the order of the commands. The joints are column (mm), shoulder, elbow, wrist (degrees),
gripper, rail (mm).

Sources: PyLabRobot/pylabrobot, pylabrobot/arms/precise_flex (which cites the TCS and GPL manuals);
AD-SDL/pf400_module, src/pf400_interface.
"""

from __future__ import annotations

import msgspec

PORT = 10100
ASK_END, ANSWER_END = b"\n", b"\r\n"

COLUMN, SHOULDER, ELBOW, WRIST, GRIPPER, RAIL = range(6)
AXES = ("column", "shoulder", "elbow", "wrist", "gripper", "rail")
LIMITS = ((0.0, 400.0), (-93.0, 93.0), (10.0, 350.0), (-960.0, 960.0), (60.0, 145.0), (-1000.0, 1000.0))
"""What the driver goes to at most, in mm and degrees."""

LONGEST = {COLUMN: (0.0, 1200.0), RAIL: (-2500.0, 2500.0)}
"""Columns and rails are sold in several lengths: the arm tells its own."""

NEUTRAL = (400.0, 1.4, 177.101, 537.107)
"""Column up, arm folded: from here it goes along the rail."""

YIELDING = (SHOULDER, ELBOW, WRIST, RAIL)
"""In free mode. The fingers go on holding, and the column, which has a weight, unless it is asked for."""
ALL_HOLD = "freemode -1"


def yields(axis: int) -> str:
    """The command for free mode of one axis. The controller counts axes from 1."""
    return f"freemode {axis + 1}"


ROBOT_TYPE, PF400 = 116, 12
SERIAL_NUMBER = 16000
"""The robot's own, in its calibration data (calib01.pac)."""

HOMED, SOFT_MAXIMA, SOFT_MINIMA = 2800, 16077, 16078
ON = 1
"""What ``hp`` and ``pd 2800`` say of an arm that is powered, and homed. Nothing else says so."""

HARD_STOP, ATTACHED = 15, 21
"""Of ``sysState``."""


class Fault(msgspec.Struct, frozen=True):
    """The meaning of a negative code, with the remedy and the effects."""

    meaning: str
    remedy: str = "Reset the module."
    effects: str = "none"


COLLIDED = "Look at the arm and at what it holds; free it by hand, then reset the module."
FAULTS = {
    -1006: Fault("another client holds the robot", "Close the pendant or the other program."),
    -1007: Fault("the robot is not ready to be attached", "Close the pendant, then reset the module."),
    -1009: Fault("no robot is attached"),
    -1012: Fault("a joint is out of its range", "Bring the arm back by hand (free mode), then reset."),
    -1021: Fault("the robot is not homed"),
    -1025: Fault("the power did not come on in time", "Check the safety circuit."),
    -1028: Fault("the emergency stop is pressed", "Release it, then reset the module."),
    -1039: Fault("the target is too close to the column", "Teach the place again."),
    -1040: Fault("the target is out of reach", "Teach the place again."),
    -1042: Fault("the arm would have to change its elbow in a straight move", "Teach the place again."),
    -1044: Fault("automatic mode is off", "Switch it on at the controller."),
    -1045: Fault("a soft emergency stop is set", "Release it, then reset the module."),
    -1046: Fault("its power is off"),
    -1602: Fault("an external emergency stop is set", "Release it, then reset the module."),
    -2805: Fault("the controller does not know this command", "Load PARobot and SSGrip on the controller."),
    -3100: Fault("a hard envelope error: it has hit something", COLLIDED, "unknown"),
    -3101: Fault("a motor is at its limit: it has hit something", COLLIDED, "unknown"),
    -3105: Fault("an axis is stalled", COLLIDED, "unknown"),
    -3122: Fault("a soft envelope error: it has hit something", COLLIDED, "unknown"),
    -3127: Fault("an encoder's battery is low", "Call the service."),
    -3128: Fault("an encoder's battery is dead", "Call the service."),
}
"""The likelier ones of some 460."""


class Grip(msgspec.Struct, frozen=True):
    """The open and the closed width of the fingers, in mm of the gripper's joint."""

    name: str
    open_mm: float
    closed_mm: float


NARROW, WIDE = Grip("narrow", 90.0, 85.0), Grip("wide", 130.0, 127.0)
BETWEEN_GRIPS_MM = 105.0
FULLY_CLOSED_MM = 62.0
"""``IsFullyClosed`` is told within 2 mm of the end."""
