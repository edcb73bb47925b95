"""A plate under the simulated camera, without a lab: what is mixed in it, and the picture of it."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

from color_solvers import Mixture

from labos.client.plate_reading import Color
from labos.node import World
from labos_drivers.camera.photo import take_photo
from labos_drivers.camera.sketch import as_file, colors_of, draw_placement, sketch

NEST = "camera_module.plate_station"


class Plate:
    """One plate."""

    def __init__(self, seed: int = 0) -> None:
        self.world, self._draw = World(), Random(seed)
        (self.plate,) = self.world.stock(NEST, "plate96")

    def mix(self, wells: Sequence[str], mixtures: Sequence[Mixture]) -> None:
        volumes = {f"color_{name}": [m[n] for m in mixtures] for n, name in enumerate("ABC")}
        self.world.work("ot2", "pipette", NEST, volumes=volumes, wells=list(wells))

    def colors(self) -> dict[str, Color]:
        """Which only the simulated bench knows."""
        return colors_of(self.world, self.plate)

    def picture(self, trouble: str = "", *, rotation_deg: float = 0.0, empty: bool = False) -> bytes:
        """A JPEG."""
        scene = sketch(self.world, "" if empty else self.plate, draw_placement(self._draw, trouble))
        return as_file(take_photo(scene, self._draw, trouble), "plate.jpg", rotation_deg)
