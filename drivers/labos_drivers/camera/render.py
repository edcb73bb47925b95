"""What a simulated network camera sees: nests side by side, with labels and markers, and a little noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from labos.node import World
from labos_drivers._optics import Color
from labos_drivers.camera.sketch import (
    EMPTY_WELL,
    HEIGHT,
    LEFT,
    NEST,
    PLASTIC,
    PX_PER_MM,
    RADIUS_MM,
    RIM,
    TOP,
    WIDTH,
    centre_of,
    colors_of,
    corner,
    cover_of,
)
from labos_drivers.camera.vision import MARKERS, Picture, cv

MARKER, MARKER_PX, MODULE_PX = 7, 140, 5


def picture_of(world: World, places: Sequence[str], seed: int) -> Picture:
    """The places from left to right; ``seed`` is that of the noise, another for each picture."""
    import numpy

    scene = numpy.hstack([_nest(world, place) for place in places]).astype(numpy.float32)
    noise = numpy.random.default_rng(seed).normal(0.0, 2.0, scene.shape)
    blurred = cv().GaussianBlur(scene, (3, 3), 0)
    return numpy.clip(blurred + noise, 0, 255).astype(numpy.uint8)


def _nest(world: World, place: str) -> Picture:
    import numpy

    view = numpy.full((HEIGHT, WIDTH, 3), NEST[::-1], numpy.uint8)
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
    cover, end = cover_of(world, plate), corner()
    cv().rectangle(view, (LEFT, TOP), end, (cover or PLASTIC)[::-1], -1)
    if cover is None:
        _wells(view, colors_of(world, plate))
    if label := world.barcode(plate):
        code = cv().QRCodeEncoder.create().encode(label)
        side = MODULE_PX * code.shape[0]
        large = cv().resize(code, (side, side), interpolation=cv().INTER_NEAREST)
        _paste(view, large, WIDTH // 2, (end[1] + HEIGHT) // 2, 10)


def _wells(view: Picture, colors: dict[str, Color]) -> None:
    for row in range(8):
        for column in range(12):
            red, green, blue = colors.get(f"{'ABCDEFGH'[row]}{column + 1}", EMPTY_WELL)
            at, radius = centre_of(row, column), round(RADIUS_MM * PX_PER_MM)
            cv().circle(view, at, radius, (blue, green, red), -1, cv().LINE_AA)
            cv().circle(view, at, radius, RIM, 2, cv().LINE_AA)


def _paste(view: Picture, image: Any, x: int, y: int, border: int) -> None:
    """An image in black and white, with a white border, about a point."""
    height, width = image.shape[:2]
    left, top = x - width // 2, y - height // 2
    view[max(top - border, 0) : top + height + border, left - border : left + width + border] = 255
    view[top : top + height, left : left + width] = image[..., None]
