"""A simulated camera."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Any

from labos_drivers._simulation import Simulated


class CameraSimulator(Simulated):
    """Sees what stands in its nest, be it a plate or nothing."""

    async def grab_image(self, file_name: str, folder: str, rotation_deg: float) -> str:
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
            return str(PurePosixPath(folder) / file_name)

    async def read_barcode(self) -> str:
        nest = self.place("plate_station")
        with self.motion():
            await self.take_time(2)
            plate = self.top(nest)
            self.world.work(self.name, "scan", nest if plate else "")
            return self.world.barcode(plate) if plate else ""

    def look(self) -> dict[str, Any]:
        seen = ["plate_station", *self.config.get("observes", ())]
        return {"labware": {place: len(self.world.at(self.place(place))) for place in seen}}
