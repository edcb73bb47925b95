"""Functions on pictures, with OpenCV. It is imported at its first use.

A picture is an array of rows, columns and three bytes (blue, green, red).
"""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Any, TypeAlias

from labos.errors import DeviceError
from labos.link.wire import needs

Picture: TypeAlias = Any

FORMATS = {".jpg": ".jpg", ".jpeg": ".jpg", ".png": ".png"}
DARK, FLAT = 8.0, 4.0
"""A picture below this mean brightness and this scatter (of 255) shows nothing."""

MARKERS = "DICT_4X4_1000"
"""The ArUco dictionary of markers on nests: that of AD-SDL/rpl_workcell, plate_color_analysis.py."""

VIEW_PX = 640
"""Views are brought to this width before wells are looked for."""

SCALES = (1.0, 1.5, 0.75)
"""A code that is not read at one size often is at another."""

FEW_WELLS = 24
ALIKE, REGULAR = 0.25, 0.2
"""By how much radii, and distances of neighbours, may differ from their median."""
MOSTLY = 0.8


def cv() -> Any:
    """The module OpenCV. Raises NotConnected if it is not installed."""
    try:
        import cv2
    except ImportError as error:
        raise needs("camera", error) from error
    return cv2


def format_of(name: str) -> str:
    """The file type for a picture of this name. Raises DeviceError if it is unknown."""
    suffix = PurePosixPath(name).suffix.lower()
    if suffix not in FORMATS:
        raise DeviceError(
            f"{name!r} has no known file type for pictures.",
            effects="none",
            remedy=f"End it with one of {', '.join(FORMATS)}.",
        )
    return FORMATS[suffix]


def decode(data: bytes) -> Picture | None:
    """The picture in a file's bytes. None if they are not a picture, or if a JPEG has no end."""
    import numpy

    whole = data[:2] != b"\xff\xd8" or data.rstrip(b"\0")[-2:] == b"\xff\xd9"
    if not data or not whole:
        return None
    # If the bytes are not a picture, some versions of OpenCV return None, others raise an error.
    try:
        return cv().imdecode(numpy.frombuffer(data, numpy.uint8), cv().IMREAD_COLOR)
    except cv().error:
        return None


def encode(picture: Picture, name: str) -> bytes:
    """The picture as the bytes of a file with this name. Raises DeviceError."""
    done, data = cv().imencode(format_of(name), picture)
    if not done:
        raise DeviceError(f"The picture cannot be written as {name!r}.", effects="all")
    return bytes(data)


def rotate(picture: Picture, degrees: float) -> Picture:
    """The picture, turned counterclockwise. It is made larger if necessary, so that nothing is cut off."""
    quarters = {90: "ROTATE_90_COUNTERCLOCKWISE", 180: "ROTATE_180", 270: "ROTATE_90_CLOCKWISE"}
    if degrees % 360 == 0:
        return picture
    if degrees % 360 in quarters:
        return cv().rotate(picture, getattr(cv(), quarters[int(degrees % 360)]))
    height, width = picture.shape[:2]
    matrix = cv().getRotationMatrix2D((width / 2, height / 2), degrees, 1.0)
    cosine, sine = abs(matrix[0, 0]), abs(matrix[0, 1])
    wide, high = round(width * cosine + height * sine), round(width * sine + height * cosine)
    matrix[:, 2] += (wide - width) / 2, (high - height) / 2
    return cv().warpAffine(picture, matrix, (wide, high))


def is_black(picture: Picture) -> bool:
    """Whether the picture shows nothing: the light is off, or something covers the lens."""
    mean, scatter = cv().meanStdDev(cv().cvtColor(picture, cv().COLOR_BGR2GRAY))
    return bool(mean[0][0] < DARK and scatter[0][0] < FLAT)


def is_same(one: Picture, other: Picture) -> bool:
    """Whether two pictures are equal bit by bit. Those of a working camera never are, because of noise."""
    return bool(one.shape == other.shape and (one == other).all())


def part(picture: Picture, view: tuple[float, float, float, float]) -> Picture:
    """A part of a picture. ``view`` is left, top, right and bottom, as fractions of the picture."""
    height, width = picture.shape[:2]
    left, top, right, bottom = view
    return picture[round(top * height) : round(bottom * height), round(left * width) : round(right * width)]


def read_label(picture: Picture) -> str:
    """The text of the label in a picture: of a QR code, else of an EAN or UPC code. Empty if there is none,
    or if there are several texts."""
    grey = cv().cvtColor(picture, cv().COLOR_BGR2GRAY)
    sizes = [grey if scale == 1 else cv().resize(grey, None, fx=scale, fy=scale) for scale in SCALES]
    qr = (cv().QRCodeDetectorAruco(), cv().QRCodeDetector())
    found = _read_texts(qr, sizes) or _read_texts((cv().barcode.BarcodeDetector(),), sizes)
    return found.pop() if len(found) == 1 else ""


def _read_texts(detectors: tuple[Any, ...], pictures: list[Picture]) -> set[str]:
    """All texts that any of the detectors reads in any of the pictures."""
    each = (detector.detectAndDecodeMulti(picture)[1] for picture in pictures for detector in detectors)
    return {text for texts in each for text in texts if text}


def is_occupied(view: Picture) -> bool | None:
    """Whether a plate stands in the nest that a view shows; None if the view does not show it.

    A label or a grid of wells is the sign of a plate. A marker is the sign of an empty nest, because a plate
    covers it. The result is None with both signs (a clear plate), with none (a plate with a lid, or an empty
    nest without a marker), and for a black picture.
    """
    if is_black(view):
        return None
    plate = bool(read_label(view)) or has_wells(view)
    bare = has_marker(view)
    return None if plate == bare else plate


def has_marker(view: Picture) -> bool:
    """Whether a view shows a marker of the dictionary ``MARKERS``."""
    aruco = cv().aruco
    detector = aruco.ArucoDetector(aruco.getPredefinedDictionary(getattr(aruco, MARKERS)))
    _, ids, _ = detector.detectMarkers(view)
    return ids is not None and len(ids) > 0


def has_wells(view: Picture) -> bool:
    """Whether a view shows round wells of equal size in a grid. The plate has to fill at least half of the
    view's width."""
    import numpy

    scale = VIEW_PX / view.shape[1]
    grey = cv().cvtColor(cv().resize(view, None, fx=scale, fy=scale), cv().COLOR_BGR2GRAY)
    circles = cv().HoughCircles(
        cv().medianBlur(grey, 5),
        cv().HOUGH_GRADIENT,
        1,
        minDist=0.03 * VIEW_PX,
        param1=80,
        param2=14,
        minRadius=round(0.011 * VIEW_PX),
        maxRadius=round(0.034 * VIEW_PX),
    )
    if circles is None:
        return False
    x, y, radius = circles.reshape(-1, 3).T
    alike = abs(radius - numpy.median(radius)) <= ALIKE * numpy.median(radius)
    if alike.sum() < FEW_WELLS:
        return False
    x, y = x[alike], y[alike]
    across, down = x[:, None] - x, y[:, None] - y
    apart = numpy.hypot(across, down)
    numpy.fill_diagonal(apart, numpy.inf)
    next_to = apart.argmin(axis=1)
    each = numpy.arange(len(x))
    distance = apart[each, next_to]
    regular = abs(distance - numpy.median(distance)) <= REGULAR * numpy.median(distance)
    if regular.mean() <= MOSTLY:
        return False
    # Neighbours in a grid lie in directions that differ by multiples of 90°, so four times the angles agree.
    # A circle that was found between wells is no part of the grid, so its direction is left out.
    angle = numpy.arctan2(down[each, next_to], across[each, next_to])[regular]
    straight = abs(numpy.exp(4j * angle).mean())
    return bool(straight > MOSTLY)
