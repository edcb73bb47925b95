"""What a simulated camera sees: nests side by side, with plates in the colours of what was pipetted.

The geometry is that of ANSI/SLAS 1-2004 and 4-2004; colours follow Beer's law to first order.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from labos.node import World
from labos.node.world import lid_of
from labos_drivers.camera.vision import MARKERS, Picture, cv

WIDTH, HEIGHT = 640, 560
"""Of one nest, in pixels."""
PX_PER_MM, LEFT, TOP = 4.2, 52, 24
PLATE_MM = (127.76, 85.48)
A1_MM, PITCH_MM, RADIUS_MM = (14.38, 11.24), 9.0, 3.43
NEST, FOIL, LID, PLASTIC, EMPTY_WELL = (92, 88, 84), (205, 204, 200), (228, 226, 222), (240, 240, 238), 236
MARKER, MARKER_PX, MODULE_PX = 7, 140, 5

WELL_UL = 275.0
ABSORBS = {"color_A": (0.1, 0.9, 0.7), "color_B": (0.8, 0.1, 0.9), "color_C": (0.9, 0.7, 0.1)}
"""How strongly a full well of each dye swallows red, green and blue."""


def picture_of(world: World, places: Sequence[str], seed: int) -> Picture:
    """The places from left to right; ``seed`` is that of the noise, another for each picture."""
    import numpy

    scene = numpy.hstack([_nest(world, place) for place in places]).astype(numpy.float32)
    noise = numpy.random.default_rng(seed).normal(0.0, 2.0, scene.shape)
    blurred = cv().GaussianBlur(scene, (3, 3), 0)
    return numpy.clip(blurred + noise, 0, 255).astype(numpy.uint8)


def colors_of(world: World, plate: str) -> dict[str, tuple[float, float, float]]:
    """Red, green and blue of each well that something was pipetted into."""
    dyes: dict[str, dict[str, float]] = {}
    for motion in world.motions("pipette"):
        if motion.plate != plate:
            continue
        wells = motion.facts.get("wells") or []
        for liquid, doses in (motion.facts.get("volumes") or {}).items():
            for well, dose in zip(wells, doses, strict=False):
                amounts = dyes.setdefault(well, {})
                amounts[liquid] = amounts.get(liquid, 0.0) + dose
    return {well: _color(amounts) for well, amounts in dyes.items()}


def _color(amounts: dict[str, float]) -> tuple[float, float, float]:
    clear = (0.0, 0.0, 0.0)
    left = [
        max(1 - sum(ABSORBS.get(liquid, clear)[channel] * ul / WELL_UL for liquid, ul in amounts.items()), 0)
        for channel in range(3)
    ]
    return 255 * left[0], 255 * left[1], 255 * left[2]


def _nest(world: World, place: str) -> Picture:
    import numpy

    view = numpy.full((HEIGHT, WIDTH, 3), NEST, numpy.uint8)
    plates = world.at(place)
    if plates:
        _plate(view, world, plates[-1])
    else:
        _marker(view)
    return view


def _marker(view: Picture) -> None:
    aruco = cv().aruco
    dictionary = aruco.getPredefinedDictionary(getattr(aruco, MARKERS))
    _paste(view, aruco.generateImageMarker(dictionary, MARKER, MARKER_PX), WIDTH // 2, 200, 20)


def _plate(view: Picture, world: World, plate: str) -> None:
    covered = (
        LID if world.at(lid_of(plate)) else FOIL if world.last(plate, "seal", "peel") == "seal" else None
    )
    corner = (round(LEFT + PLATE_MM[0] * PX_PER_MM), round(TOP + PLATE_MM[1] * PX_PER_MM))
    cv().rectangle(view, (LEFT, TOP), corner, covered or PLASTIC, -1)
    if covered is None:
        _wells(view, colors_of(world, plate))
    if label := world.barcode(plate):
        code = cv().QRCodeEncoder.create().encode(label)
        side = MODULE_PX * code.shape[0]
        large = cv().resize(code, (side, side), interpolation=cv().INTER_NEAREST)
        _paste(view, large, WIDTH // 2, (corner[1] + HEIGHT) // 2, 10)


def _wells(view: Picture, colors: dict[str, tuple[float, float, float]]) -> None:
    for row in range(8):
        for column in range(12):
            x = LEFT + (A1_MM[0] + PITCH_MM * column) * PX_PER_MM
            y = TOP + (A1_MM[1] + PITCH_MM * row) * PX_PER_MM
            red, green, blue = colors.get(f"{'ABCDEFGH'[row]}{column + 1}", (EMPTY_WELL,) * 3)
            at, radius = (round(x), round(y)), round(RADIUS_MM * PX_PER_MM)
            cv().circle(view, at, radius, (blue, green, red), -1, cv().LINE_AA)
            cv().circle(view, at, radius, (120, 120, 120), 2, cv().LINE_AA)


def _paste(view: Picture, image: Any, x: int, y: int, border: int) -> None:
    """An image in black and white, with a white border, about a point."""
    height, width = image.shape[:2]
    left, top = x - width // 2, y - height // 2
    view[max(top - border, 0) : top + height + border, left - border : left + width + border] = 255
    view[top : top + height, left : left + width] = image[..., None]
