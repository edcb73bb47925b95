"""The colours of wells in an image of a plate, measured with OpenCV.

Four ArUco markers around the nest show where the plate should be in the image; its wells must be there. The
white plastic between the wells shows the local brightness, so that colours do not depend on the light.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from labos.errors import BadInput, LabosError

Color = tuple[float, float, float]
"""Red, green and blue, 0 to 255."""

PX_PER_MM = 6
PLATE_MM, A1_MM, PITCH_MM, WELL_MM = (127.76, 85.48), (14.38, 11.24), 9.0, 3.43
"""ANSI/SLAS 1-2004 and 4-2004; the radius of a well of the plate in use."""

MARKERS = "DICT_5X5_50"
MARKERS_MM = {0: (-8.0, 8.0), 1: (135.6, 8.0), 2: (135.6, 78.0), 3: (-8.0, 78.0)}
"""The positions of the markers' centres, from the plate's upper left corner; to be measured once for each
nest."""
MARKER_MM = 9.8
FEWEST_MARKERS = 3

WHITE = 239.0
"""The value of the plate's plastic where there is enough light."""

SATURATED, TOO_MANY = 250, 0.05
"""The first value is the brightness of a pixel that cannot be measured; the second is the largest part of the
plastic that may be so bright."""

FEWEST_WELLS = 64
OFF_MM = 1.2
"""A plate whose wells are farther than this from their places does not lie in its nest."""


class BadPicture(LabosError):
    """An image that cannot be used: an experiment error. ``kind`` is the reason in a few words."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


class Reading(NamedTuple):
    """The colours of wells; how far the plate was from where it should be (mm)."""

    colors: dict[str, Color]
    off_mm: tuple[float, float]


def read_plate(content: bytes, wells: Sequence[str]) -> Reading:
    """The colours of wells in an image, given as the content of its file. Raises BadPicture."""
    cv = _import_opencv()
    try:
        picture = cv.imdecode(np.frombuffer(content, np.uint8), cv.IMREAD_COLOR)
    except cv.error:
        picture = None
    if picture is None:
        raise BadPicture("no picture", "The file contains no picture.")
    plate = straighten_picture(picture)
    if _is_saturated(plate):
        raise BadPicture(
            "saturated", "The picture is saturated: there is too much light, or it was exposed for too long."
        )
    off = _measure_offsets(plate)
    light = _fit_light(plate, off)
    colors = {well: _read_color(plate, light, well, off) for well in wells}
    return Reading(colors, (round(float(off[0]), 2), round(float(off[1]), 2)))


def straighten_picture(picture: Any) -> Any:
    """The plate as seen from straight above, with ``PX_PER_MM``. Raises BadPicture."""
    cv = _import_opencv()
    detector = cv.aruco.ArucoDetector(cv.aruco.getPredefinedDictionary(getattr(cv.aruco, MARKERS)))
    corners, ids, _ = detector.detectMarkers(picture)
    known = {int(i): c[0] for i, c in zip([] if ids is None else ids.ravel(), corners, strict=True)}
    found = sorted(known.keys() & MARKERS_MM.keys())
    if len(found) < FEWEST_MARKERS:
        raise BadPicture(
            "markers hidden",
            f"Only {len(found)} of {len(MARKERS_MM)} markers are visible: something covers the others.",
        )
    half = MARKER_MM / 2
    square = np.array([(-half, -half), (half, -half), (half, half), (-half, half)])
    seen = np.vstack([known[number] for number in found])
    real = np.vstack([np.array(MARKERS_MM[number]) + square for number in found]) * PX_PER_MM
    mapping, _ = cv.findHomography(seen, real, cv.RANSAC, 4.0)
    if mapping is None:
        raise BadPicture("markers hidden", "The markers are not at their expected positions.")
    return cv.warpPerspective(picture, mapping, tuple(round(side * PX_PER_MM) for side in PLATE_MM))


def _is_saturated(plate: Any) -> bool:
    points = np.round(_list_points_between()).astype(int)
    return bool(np.mean(plate[points[:, 1], points[:, 0]].max(axis=1) >= SATURATED) > TOO_MANY)


def _measure_offsets(plate: Any) -> np.ndarray:
    """How far the wells are from where they should be (mm). Raises BadPicture."""
    cv = _import_opencv()
    grey = cv.GaussianBlur(cv.cvtColor(plate, cv.COLOR_BGR2GRAY), (5, 5), 1.2)
    radius = WELL_MM * PX_PER_MM
    circles = cv.HoughCircles(
        grey,
        cv.HOUGH_GRADIENT,
        1,
        minDist=0.7 * PITCH_MM * PX_PER_MM,
        param1=80,
        param2=12,
        minRadius=round(0.75 * radius),
        maxRadius=round(1.25 * radius),
    )
    seen = np.zeros((0, 2)) if circles is None else circles.reshape(-1, 3)[:, :2] / PX_PER_MM
    steps = (seen - A1_MM) / PITCH_MM
    near = np.round(steps)
    inside = ((near >= 0) & (near <= (11, 7))).all(axis=1)
    away = (steps - near)[inside] * PITCH_MM
    off = np.median(away, axis=0) if len(away) else np.full(2, np.inf)
    with_it = np.hypot(*(away - off).T) < 0.6 if len(away) else np.zeros(0, bool)
    if with_it.sum() < FEWEST_WELLS:
        raise BadPicture("plate not found", f"Only {with_it.sum()} wells are at their expected positions.")
    if np.hypot(*off) > OFF_MM:
        raise BadPicture("plate not found", f"The plate lies {np.hypot(*off):.1f} mm away from its nest.")
    return np.asarray(off)


def _fit_light(plate: np.ndarray, off: np.ndarray) -> np.ndarray:
    """How the brightness of the plastic depends on the place: a weight for each term and channel."""
    points = _list_points_between() + off * PX_PER_MM
    places = np.round(points).astype(int)
    light = np.array([np.median(plate[v - 3 : v + 4, u - 3 : u + 4], axis=(0, 1)) for u, v in places])
    weights, *_ = np.linalg.lstsq(_make_terms(*points.T), light, rcond=None)
    return np.asarray(weights)


def _make_terms(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Light varies smoothly: a surface of the third order."""
    x, y = x / (PLATE_MM[0] * PX_PER_MM) - 0.5, y / (PLATE_MM[1] * PX_PER_MM) - 0.5
    one = np.ones_like(x)
    return np.column_stack([one, x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3])


def _list_points_between() -> np.ndarray:
    """Points of plastic between four wells each, in pixels."""
    column, row = np.meshgrid(np.arange(-0.5, 12), np.arange(-0.5, 8))
    points = np.column_stack([column.ravel(), row.ravel()]) * PITCH_MM + A1_MM
    return np.asarray(points * PX_PER_MM)


def _read_color(plate: np.ndarray, light: np.ndarray, well: str, off: np.ndarray) -> Color:
    """The colour in the middle of a well, corrected to even, white light, in which the plastic is ``WHITE``.
    The median removes the reflection of the lamp on the liquid's surface; the liquid's dark edge is not
    measured."""
    at = np.array([int(well[1:]) - 1, "ABCDEFGH".index(well[0])]) * PITCH_MM + A1_MM + off
    x, y = at * PX_PER_MM
    reach = int(0.6 * WELL_MM * PX_PER_MM)
    v, u = np.mgrid[round(y) - reach : round(y) + reach + 1, round(x) - reach : round(x) + reach + 1]
    inside = np.hypot(u - x, v - y) <= reach
    u, v = u[inside], v[inside]
    blue, green, red = np.median(plate[v, u] * (WHITE / (_make_terms(u, v) @ light)), axis=0)
    return round(float(red), 1), round(float(green), 1), round(float(blue), 1)


def _import_opencv() -> Any:
    try:
        import cv2
    except ImportError as error:
        raise BadInput("OpenCV is not installed.", remedy='Run: pip install "labos-sdl[camera]"') from error
    return cv2
