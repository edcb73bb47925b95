"""Frames in space: the position and rotation of one thing in the frame of another. Lengths are in mm, angles
in degrees."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, cos, degrees, hypot, radians, sin
from typing import NamedTuple

Three = tuple[float, float, float]
Matrix = tuple[Three, Three, Three]


class Frame(NamedTuple):
    """A frame: the directions of its axes as the columns of ``turn``, its origin ``at`` in mm."""

    turn: Matrix
    at: Three

    def then(self, inner: Frame) -> Frame:
        """The frame ``inner``, which is given in this frame, in the frame outside this one."""
        columns = tuple(zip(*inner.turn, strict=True))
        turn = tuple(tuple(_dot(row, column) for column in columns) for row in self.turn)
        return Frame(_matrix(turn), self.point(inner.at))

    def point(self, at: Sequence[float]) -> Three:
        """A point that is given in this frame, in the outer frame."""
        x, y, z = (_dot(row, at) + here for row, here in zip(self.turn, self.at, strict=True))
        return x, y, z

    def inverse(self) -> Frame:
        """The outer frame, relative to this one."""
        turn = _matrix(tuple(zip(*self.turn, strict=True)))
        x, y, z = (-_dot(row, self.at) for row in turn)
        return Frame(turn, (x, y, z))

    @property
    def angles(self) -> Three:
        """Its rotations about the fixed x, y and z axes, in this order, in degrees."""
        (r00, r01, _), (r10, r11, _), (r20, r21, r22) = self.turn
        level = hypot(r00, r10)
        if level < 1e-9:
            return 0.0, degrees(atan2(-r20, level)), degrees(atan2(-r01, r11))
        return degrees(atan2(r21, r22)), degrees(atan2(-r20, level)), degrees(atan2(r10, r00))


def frame(at_mm: Sequence[float] = (0, 0, 0), turn_deg: Sequence[float] = (0, 0, 0)) -> Frame:
    """A frame at a point, turned about x, then y, then z of the outer frame."""
    (cr, cp, cy), (sr, sp, sy) = ([f(radians(angle)) for angle in turn_deg] for f in (cos, sin))
    turn = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    x, y, z = at_mm
    return Frame(turn, (x, y, z))


def slide(axis: Sequence[float], by_mm: float) -> Frame:
    """A frame moved along an axis."""
    x, y, z = (by_mm * part for part in unit(axis))
    return frame((x, y, z))


def spin(axis: Sequence[float], by_deg: float) -> Frame:
    """A frame turned about an axis, counter-clockwise as seen from the end of the axis."""
    (x, y, z), c, s = unit(axis), cos(radians(by_deg)), sin(radians(by_deg))
    k = 1 - c
    turn = (
        (c + x * x * k, x * y * k - z * s, x * z * k + y * s),
        (y * x * k + z * s, c + y * y * k, y * z * k - x * s),
        (z * x * k - y * s, z * y * k + x * s, c + z * z * k),
    )
    return Frame(turn, (0.0, 0.0, 0.0))


def from_quaternion(at_mm: Sequence[float], turn: Sequence[float]) -> Frame:
    """A frame at a point, turned by the quaternion w, x, y, z of any length except 0."""
    w, x, y, z = turn
    size = hypot(w, x, y, z)
    w, x, y, z = w / size, x / size, y / size, z / size
    matrix = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    a, b, c = at_mm
    return Frame(matrix, (a, b, c))


def unit(axis: Sequence[float]) -> Three:
    """A direction as a vector of length 1."""
    size = hypot(*axis)
    x, y, z = (part / size for part in axis)
    return x, y, z


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


def _matrix(rows: Sequence[Sequence[float]]) -> Matrix:
    (a, b, c), (d, e, f), (g, h, i) = rows
    return (a, b, c), (d, e, f), (g, h, i)
