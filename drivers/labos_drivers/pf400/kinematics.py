"""The kinematics of a PF400, which has three links in a plane, a column and a rail.

x points away from the column's face and along the rail, y to the left, z up. x and y are 0 on the axis of the
shoulder with the rail at 0. Lengths and directions are those of AD-SDL/pf400_module, pf400_kinematics.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import acos, atan2, cos, degrees, hypot, radians, sin

INNER_MM, OUTER_MM, HAND_MM = 302.0, 289.0, 162.0
NEARBY_MM = (0.0, *(sign * step for step in range(50, 401, 50) for sign in (1.0, -1.0)))

Joints = tuple[float, ...]
Limits = Sequence[tuple[float, float]]


def find_hand(joints: Joints) -> tuple[float, float, float, float]:
    """x, y and z of the middle of the fingers (mm), and their direction (degrees)."""
    z, *angles = joints[:4]
    first = radians(angles[0])
    second = first + radians(angles[1])
    third = second + radians(angles[2])
    x = INNER_MM * cos(first) + OUTER_MM * cos(second) + HAND_MM * cos(third)
    y = INNER_MM * sin(first) + OUTER_MM * sin(second) + HAND_MM * sin(third)
    return x + joints[5], y, z, degrees(third)


def solve_reach(joints: Joints, yaw: float, rail: float) -> Joints | None:
    """Joints with the hand at the same position as with ``joints``, but with the direction ``yaw`` (degrees)
    and the rail at ``rail`` (mm). The elbow stays on its side. None if the arm is too short or too long."""
    x, y, z, _ = find_hand(joints)
    x, y = x - rail - HAND_MM * cos(radians(yaw)), y - HAND_MM * sin(radians(yaw))
    bend = (hypot(x, y) ** 2 - INNER_MM**2 - OUTER_MM**2) / (2 * INNER_MM * OUTER_MM)
    if abs(bend) > 1:
        return None
    elbow = degrees(acos(bend)) if joints[2] % 360 < 180 else 360 - degrees(acos(bend))
    turned = radians(elbow)
    shoulder = degrees(atan2(y, x) - atan2(OUTER_MM * sin(turned), INNER_MM + OUTER_MM * cos(turned)))
    shoulder = _unwind(shoulder, 0.0)
    return z, shoulder, elbow, _unwind(yaw - shoulder - elbow, joints[3]), joints[4], rail


def turn_hand(joints: Joints, degrees_: float, limits: Limits) -> Joints | None:
    """Joints with the hand at the same position, but turned by ``degrees_`` in either direction. The rail
    moves as little as possible, in steps of 50 mm up to 400 mm. None if the limits do not allow it."""
    yaw = find_hand(joints)[3]
    for away in NEARBY_MM:
        for sign in (1, -1):
            found = solve_reach(joints, yaw + sign * degrees_, joints[5] + away)
            if found is not None and all(
                low <= value <= high for value, (low, high) in zip(found, limits, strict=True)
            ):
                return found
    return None


def _unwind(angle: float, other: float) -> float:
    """The same angle (degrees), at most half a turn away from another one."""
    return angle - 360 * round((angle - other) / 360)
