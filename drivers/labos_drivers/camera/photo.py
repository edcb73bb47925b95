"""Photographs of a simulated scene: perspective, uneven light, blur and noise of a camera, and faults of
pictures.

The pictures are made with Pillow, which is always installed. So a lab can be simulated without OpenCV.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from random import Random  # noqa: TID251 (the caller gives the seed)
from typing import Any, TypeAlias

Photograph: TypeAlias = Any
"""An image of Pillow, which is imported when the first one is taken."""
Point: TypeAlias = tuple[float, float]

SEEN: tuple[Point, ...] = ((0.008, 0.012), (0.990, 0.005), (0.982, 0.992), (0.015, 0.986))
"""Where the corners of the scene are in the picture, as fractions of it: the camera does not look straight
down."""

BESIDE = (70, 74, 78)
"""What lies beside the scene."""

LIGHT = (1.0, 0.985, 0.95)
"""What there is of red, green and blue: the lamp is warm."""
DARKER, ASIDE = 0.16, 0.08
"""How much less light there is in the corners, and on the right."""

NOISE, BLUR_PX = 2.2, 0.5
TROUBLES = ("overexposed", "hidden", "askew")
"""What may be wrong: too much light; a cable over markers; the plate does not lie in its nest."""

TOO_MUCH = 1.7


def image_library() -> tuple[Any, Any]:
    """The modules of Pillow for images and for drawing on them."""
    from PIL import Image, ImageDraw

    return Image, ImageDraw


def take_photo(scene: Photograph, draw: Random, trouble: str = "") -> Photograph:
    """The picture that a camera takes of a scene. ``draw`` gives the random numbers. ``trouble`` is one of
    ``TROUBLES``, or empty."""
    from PIL import ImageChops, ImageFilter

    images, drawing = image_library()
    if trouble == "hidden":
        scene = scene.copy()
        _cable(drawing.Draw(scene), *scene.size)
    seen = scene.transform(
        scene.size,
        images.Transform.PERSPECTIVE,
        _back(scene.size),
        images.Resampling.BILINEAR,
        fillcolor=BESIDE,
    )
    lit = ImageChops.multiply(seen, _light(scene.size)).filter(ImageFilter.BoxBlur(BLUR_PX))
    if trouble == "overexposed":
        lit = lit.point([min(round(TOO_MUCH * value), 255) for value in range(256)] * 3)
    return ImageChops.add(lit, _noise(scene.size, draw), scale=1, offset=-128)


def project(point: Point, size: tuple[int, int]) -> Point:
    """The position of a point of the scene in the picture. Both are in pixels."""
    a, b, c, d, e, f, g, h = _mapping(_corners(size), _targets(size))
    x, y = point
    w = g * x + h * y + 1
    return (a * x + b * y + c) / w, (d * x + e * y + f) / w


def _corners(size: tuple[int, int]) -> list[Point]:
    width, height = size
    return [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)]


def _targets(size: tuple[int, int]) -> list[Point]:
    return [(x * size[0], y * size[1]) for x, y in SEEN]


def _back(size: tuple[int, int]) -> list[float]:
    """The perspective from the picture to the scene: Pillow needs this direction."""
    return _mapping(_targets(size), _corners(size))


def _mapping(sources: Sequence[Point], targets: Sequence[Point]) -> list[float]:
    """The eight numbers of the perspective that maps four points to four others."""
    rows = []
    for (x, y), (u, v) in zip(sources, targets, strict=True):
        rows.append([x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y, u])
        rows.append([0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y, v])
    for column in range(8):
        best = max(range(column, 8), key=lambda row: abs(rows[row][column]))
        rows[column], rows[best] = rows[best], rows[column]
        head = [value / rows[column][column] for value in rows[column]]
        rows[column] = head
        for row in range(8):
            if row != column:
                factor = rows[row][column]
                rows[row] = [value - factor * top for value, top in zip(rows[row], head, strict=True)]
    return [row[8] for row in rows]


@cache
def _light(size: tuple[int, int]) -> Photograph:
    """The light at each point, as a picture by which the scene is multiplied."""
    from PIL import ImageChops

    images, _ = image_library()
    # Pillow's gradient is 0 in the middle and 255 at the edges.
    middle = images.radial_gradient("L").resize(size, images.Resampling.BILINEAR)
    middle = middle.point([round(255 - DARKER * value) for value in range(256)])
    side = images.linear_gradient("L").rotate(90).resize(size, images.Resampling.BILINEAR)
    side = side.point([round(255 - ASIDE * value) for value in range(256)])
    both = ImageChops.multiply(middle, side)
    return images.merge("RGB", [both.point([round(part * value) for value in range(256)]) for part in LIGHT])


def _noise(size: tuple[int, int], draw: Random) -> Photograph:
    """A picture of noise: mean 128, standard deviation ``NOISE``."""
    images, _ = image_library()
    count = 3 * size[0] * size[1]
    one, other = (images.frombytes("RGB", size, draw.randbytes(count)) for _ in range(2))
    spread = 255 / 12**0.5 / 2**0.5
    return images.blend(one, other, 0.5).point(
        [round(128 + (value - 127.5) * NOISE / spread) for value in range(256)] * 3
    )


def _cable(draw: Any, width: int, height: int) -> None:
    """Draw a cable over the markers on the left."""
    draw.line(
        [(0.01 * width, 0), (0.07 * width, 0.3 * height), (0.03 * width, height)], fill=(20, 20, 24), width=50
    )
