"""The scene under a simulated camera, seen vertically from above: the nest with its corner markers, the
plate, and the colours of the liquids in it.

The geometry is that of ANSI/SLAS 1-2004 and 4-2004. Four ArUco markers (5x5, numbers 0 to 3) lie left and
right of the plate, at the height of its rim.
"""

from __future__ import annotations

import io
from random import Random  # noqa: TID251 (the caller gives the seed)
from typing import NamedTuple

from labos.node import World
from labos.node.world import lid_of
from labos_drivers._optics import Color, color_of
from labos_drivers.camera.photo import Photograph, image_library
from labos_drivers.camera.vision import format_of

WIDTH, HEIGHT = 800, 700
"""Of one nest, in pixels."""
PX_PER_MM, LEFT, TOP = 5.0, 81, 30
PLATE_MM = (127.76, 85.48)
A1_MM, PITCH_MM, RADIUS_MM = (14.38, 11.24), 9.0, 3.43
NEST, FOIL, LID, PLASTIC = (84, 88, 92), (200, 204, 205), (222, 226, 228), (238, 240, 240)
"""Red, green and blue."""
SLACK_MM = 0.4
"""How far a plate may stand from the middle of its nest, to any side."""
EMPTY_WELL, RIM, PAPER = (236, 236, 236), (120, 120, 120), (245, 245, 245)

CORNER_MARKERS = (
    ("10100", "01011", "01100", "10101", "11100"),
    ("00001", "11000", "00001", "10111", "00110"),
    ("11010", "11110", "00011", "10110", "11101"),
    ("10000", "00111", "00101", "01111", "10111"),
)
"""Of the dictionary ``DICT_5X5_50``, row by row."""
CORNERS_PX = ((41, 70), (759, 70), (759, 420), (41, 420))
"""Their centres, from number 0 on."""
MODULE_PX = 7

WALL, SHINE = 0.82, (1.35, 0.28, 0.24)
"""How dark a liquid is at the wall of its well, where its surface bends up; and the lamp in its surface: how
much brighter, how far from the centre and how wide, in radii."""


def colors_of(world: World, plate: str) -> dict[str, Color]:
    """The colour (red, green and blue, 0 to 255) of each well that contains liquid."""
    contents = world.contents(plate).items()
    return {well: color_of(amounts) for well, amounts in contents if sum(amounts.values())}


def cover_of(world: World, plate: str) -> tuple[int, int, int] | None:
    """The colour of the lid or the foil over the wells; None if they are open."""
    if world.at(lid_of(plate)):
        return LID
    return FOIL if world.last(plate, "seal", "peel") == "seal" else None


def corner() -> tuple[int, int]:
    """The position of the plate's lower right corner, in pixels."""
    return round(LEFT + PLATE_MM[0] * PX_PER_MM), round(TOP + PLATE_MM[1] * PX_PER_MM)


def centre_of(row: int, column: int) -> tuple[int, int]:
    """The centre of a well, in pixels. Row and column are counted from 0."""
    x = LEFT + (A1_MM[0] + PITCH_MM * column) * PX_PER_MM
    y = TOP + (A1_MM[1] + PITCH_MM * row) * PX_PER_MM
    return round(x), round(y)


class Placement(NamedTuple):
    """How a plate lies in its nest: its distance from the right position (pixels) and its angle (degrees)."""

    right: float = 0.0
    down: float = 0.0
    turned: float = 0.0


def draw_placement(draw: Random, trouble: str = "") -> Placement:
    """A random placement within the play of the nest. With the trouble ``askew``, the plate is outside it."""
    play = SLACK_MM * PX_PER_MM
    right, down = draw.uniform(-play, play), draw.uniform(-play, play)
    return Placement(right, down + 3 * PX_PER_MM, 3.0) if trouble == "askew" else Placement(right, down)


def sketch(world: World, plate: str, at: Placement = Placement()) -> Photograph:  # noqa: B008 (it cannot be changed)
    """An image of the nest with this plate (empty: no plate), without the effects of a lens and a lamp."""
    images, drawing = image_library()
    image = images.new("RGB", (WIDTH, HEIGHT), NEST)
    draw = drawing.Draw(image)
    for modules, (x, y) in zip(CORNER_MARKERS, CORNERS_PX, strict=True):
        _marker(draw, modules, x, y)
    if plate:
        seen = _plate(world, plate)
        mask = images.new("L", seen.size, 255).rotate(at.turned, images.Resampling.BICUBIC, expand=True)
        seen = seen.rotate(at.turned, images.Resampling.BICUBIC, expand=True)
        image.paste(seen, (round(LEFT + at.right), round(TOP + at.down)), mask)
    return image


def _plate(world: World, plate: str) -> Photograph:
    images, drawing = image_library()
    right, bottom = corner()
    cover = cover_of(world, plate)
    seen = images.new("RGB", (right - LEFT, bottom - TOP), cover or PLASTIC)
    if cover is None:
        _wells(drawing.Draw(seen), colors_of(world, plate))
    return seen


def as_file(image: Photograph, file_name: str, rotation_deg: float) -> bytes:
    """The image as bytes of a file, turned counterclockwise. Raises DeviceError if its type is unknown."""
    kind = {".jpg": "JPEG", ".png": "PNG"}[format_of(file_name)]
    file = io.BytesIO()
    image.rotate(rotation_deg, expand=True).save(file, kind, **({"quality": 95} if kind == "JPEG" else {}))
    return file.getvalue()


def _marker(draw: Photograph, modules: tuple[str, ...], x: int, y: int) -> None:
    """Draw a marker: black, with a white border as wide as one of its modules."""
    for half, fill in ((4.5, PAPER), (3.5, (12, 12, 12))):
        draw.rectangle((x - half * MODULE_PX, y - half * MODULE_PX, *_end(x, y, half)), fill=fill)
    for row, bits in enumerate(modules):
        for column, bit in enumerate(bits):
            if bit == "1":
                left, top = x + (column - 2.5) * MODULE_PX, y + (row - 2.5) * MODULE_PX
                draw.rectangle((left, top, left + MODULE_PX - 1, top + MODULE_PX - 1), fill=PAPER)


def _end(x: int, y: int, half: float) -> tuple[float, float]:
    return x + half * MODULE_PX - 1, y + half * MODULE_PX - 1


def _wells(draw: Photograph, colors: dict[str, Color]) -> None:
    radius = round(RADIUS_MM * PX_PER_MM)
    for row in range(8):
        for column in range(12):
            x, y = centre_of(row, column)
            x, y = x - LEFT, y - TOP
            filled = colors.get(f"{'ABCDEFGH'[row]}{column + 1}")
            rim = radius + 2
            around = (x - rim, y - rim, x + rim, y + rim)
            if filled is None:
                draw.ellipse(around, fill=EMPTY_WELL, outline=RIM, width=3)
            else:
                draw.ellipse(around, fill=_shade(filled, WALL), outline=RIM, width=3)
                _liquid(draw, filled, x, y, radius)


def _liquid(draw: Photograph, color: Color, x: int, y: int, radius: int) -> None:
    """Draw the flat middle of a meniscus, with the reflection of the lamp."""
    flat = round(0.78 * radius)
    draw.ellipse((x - flat, y - flat, x + flat, y + flat), fill=_shade(color, 1.0))
    brighter, away, wide = SHINE
    left, top, spot = x - away * radius, y - away * radius, wide * radius / 2
    lit = _shade((color[0] + 60, color[1] + 60, color[2] + 60), brighter)
    draw.ellipse((left - spot, top - spot, left + spot, top + spot), fill=lit)


def _shade(color: Color, factor: float) -> tuple[int, int, int]:
    red, green, blue = (min(round(part * factor), 255) for part in color)
    return red, green, blue
