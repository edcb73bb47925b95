"""How a simulated camera shows a nest: where the plate is, and the colours of what was pipetted.

The geometry is that of ANSI/SLAS 1-2004 and 4-2004.
"""

from __future__ import annotations

import io

from labos.node import World
from labos.node.world import lid_of
from labos_drivers._optics import Color, color_of
from labos_drivers.camera.vision import format_of

WIDTH, HEIGHT = 640, 560
"""Of one nest, in pixels."""
PX_PER_MM, LEFT, TOP = 4.2, 52, 24
PLATE_MM = (127.76, 85.48)
A1_MM, PITCH_MM, RADIUS_MM = (14.38, 11.24), 9.0, 3.43
NEST, FOIL, LID, PLASTIC = (84, 88, 92), (200, 204, 205), (222, 226, 228), (238, 240, 240)
"""Red, green and blue."""
EMPTY_WELL, RIM = (236, 236, 236), (120, 120, 120)


def colors_of(world: World, plate: str) -> dict[str, Color]:
    """Red, green and blue of each well that something was pipetted into."""
    contents = world.contents(plate).items()
    return {well: color_of(amounts) for well, amounts in contents if sum(amounts.values())}


def cover_of(world: World, plate: str) -> tuple[int, int, int] | None:
    """The colour of what lies over the wells; None if nothing does."""
    if world.at(lid_of(plate)):
        return LID
    return FOIL if world.last(plate, "seal", "peel") == "seal" else None


def corner() -> tuple[int, int]:
    """The plate's lower right corner, in pixels."""
    return round(LEFT + PLATE_MM[0] * PX_PER_MM), round(TOP + PLATE_MM[1] * PX_PER_MM)


def centre_of(row: int, column: int) -> tuple[int, int]:
    """The centre of a well, counted from 0, in pixels."""
    x = LEFT + (A1_MM[0] + PITCH_MM * column) * PX_PER_MM
    y = TOP + (A1_MM[1] + PITCH_MM * row) * PX_PER_MM
    return round(x), round(y)


def sketch(world: World, plate: str, file_name: str, rotation_deg: float) -> bytes:
    """The picture of a nest with this plate in it (none, if it is empty), as a file of this name. Raises
    DeviceError for one that names no kind of picture."""
    from PIL import Image, ImageDraw

    kind = {".jpg": "JPEG", ".png": "PNG"}[format_of(file_name)]
    image = Image.new("RGB", (WIDTH, HEIGHT), NEST)
    draw = ImageDraw.Draw(image)
    if plate:
        cover = cover_of(world, plate)
        draw.rectangle(((LEFT, TOP), corner()), fill=cover or PLASTIC)
        colors, radius = {} if cover else colors_of(world, plate), round(RADIUS_MM * PX_PER_MM)
        for row in range(0 if cover else 8):
            for column in range(12):
                x, y = centre_of(row, column)
                color = colors.get(f"{'ABCDEFGH'[row]}{column + 1}", EMPTY_WELL)
                red, green, blue = (round(part) for part in color)
                around = (x - radius, y - radius, x + radius, y + radius)
                draw.ellipse(around, fill=(red, green, blue), outline=RIM, width=2)
    file = io.BytesIO()
    image.rotate(rotation_deg, expand=True).save(file, kind, **({"quality": 95} if kind == "JPEG" else {}))
    return file.getvalue()
