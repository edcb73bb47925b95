"""The pictures of a simulated network camera: nests side by side, with labels and markers."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random  # noqa: TID251 (the caller gives the seed)
from typing import Any

from labos.node import World
from labos_drivers.camera.photo import take_photo
from labos_drivers.camera.sketch import HEIGHT, WIDTH, corner, draw_placement, sketch
from labos_drivers.camera.vision import MARKERS, Picture, cv

MARKER, MARKER_PX, MODULE_PX = 7, 140, 7


def picture_of(world: World, places: Sequence[str], seed: int) -> Picture:
    """A picture of the places from left to right. Each picture needs a new ``seed``."""
    import numpy

    draw = Random(seed)
    return numpy.hstack([_nest(world, place, draw) for place in places])


def _nest(world: World, place: str, draw: Random) -> Picture:
    import numpy
    from PIL import Image

    plates = world.at(place)
    plate = plates[-1] if plates else ""
    view = numpy.asarray(sketch(world, plate, draw_placement(draw))).copy()
    if not plate:
        _marker(view)
    elif label := world.barcode(plate):
        code = cv().QRCodeEncoder.create().encode(label)
        side = MODULE_PX * code.shape[0]
        large = cv().resize(code, (side, side), interpolation=cv().INTER_NEAREST)
        _paste(view, large, WIDTH // 2, (corner()[1] + HEIGHT) // 2, 10)
    seen = numpy.asarray(take_photo(Image.fromarray(view), draw))
    return numpy.ascontiguousarray(seen[:, :, ::-1])


def _marker(view: Picture) -> None:
    aruco = cv().aruco
    dictionary = aruco.getPredefinedDictionary(getattr(aruco, MARKERS))
    _paste(view, aruco.generateImageMarker(dictionary, MARKER, MARKER_PX), WIDTH // 2, 200, 20)


def _paste(view: Picture, image: Any, x: int, y: int, border: int) -> None:
    """Paste a black and white image with a white border. Its centre is at ``x``, ``y``. All are in pixels."""
    height, width = image.shape[:2]
    left, top = x - width // 2, y - height // 2
    view[max(top - border, 0) : top + height + border, left - border : left + width + border] = 255
    view[top : top + height, left : left + width] = image[..., None]
