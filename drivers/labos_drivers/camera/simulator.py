"""A simulated camera."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Any

from labos.node import Attachment
from labos_drivers._simulation import Simulated
from labos_drivers.camera.photo import TROUBLES, take_photo
from labos_drivers.camera.sketch import as_file, draw_placement, sketch
from labos_drivers.camera.vision import format_of


class CameraSimulator(Simulated):
    """A camera above its nest, which may be empty. ``bad_pictures`` of its configuration is the fraction of
    pictures with a fault (0 to 1)."""

    async def grab_image(self, file_name: str, folder: str, rotation_deg: float) -> Attachment:
        format_of(file_name)
        nest = self.place("plate_station")
        with self.motion():
            await self.take_time(5)
            self.world.work(
                self.name,
                "picture",
                nest if self.top(nest) else "",
                file=file_name,
                rotation_deg=rotation_deg,
            )
            trouble = self._find_trouble()
            scene = sketch(self.world, self.top(nest), draw_placement(self._random, trouble))
            shown = as_file(take_photo(scene, self._random, trouble), file_name, rotation_deg)
            return Attachment(str(PurePosixPath(folder) / file_name), shown)

    def _find_trouble(self) -> str:
        """The fault of the picture that is taken now, at random; empty if there is none."""
        often = float(self.config.get("bad_pictures", 0.0))
        return self._random.choice(TROUBLES) if self._random.random() < often else ""

    async def read_barcode(self) -> str:
        nest = self.place("plate_station")
        with self.motion():
            await self.take_time(2)
            plate = self.top(nest)
            self.world.work(self.name, "scan", nest if plate else "")
            return self.world.barcode(plate) if plate else ""

    def observe(self) -> dict[str, Any]:
        """The number of pieces of labware in its nest and at each place that it ``observes``. If it ``reads``
        labels, the barcode of a single piece instead."""
        seen = ["plate_station", *self.config.get("observes", ())]
        counted: dict[str, int | str] = {place: len(self.world.at(self.place(place))) for place in seen}
        for place in seen if self.config.get("reads") else ():
            label = self.world.barcode(self.top(self.place(place))) if counted[place] == 1 else ""
            counted[place] = label or counted[place]
        return {"labware": counted}
