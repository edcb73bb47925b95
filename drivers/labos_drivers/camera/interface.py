"""What the camera offers."""

from __future__ import annotations

from typing import Annotated

from labos.node import Needs, Param, Reads, Station, action
from labos_drivers._simulation import Instrument
from labos_drivers.camera.simulator import CameraSimulator


class Camera(Instrument):
    """USB camera above a plate nest."""

    driver = "camera"
    models = ("camera", "camera (logitech)")
    stations = (Station("plate_station"),)
    device: CameraSimulator

    async def connect(self) -> None:
        self.device = CameraSimulator(self.setup)

    @action(Needs(), duration_s=5, safe_to_repeat=True, aliases=("take_picture",))
    async def grab_image(
        self,
        file_name: Annotated[str, Param(description="name of the picture")] = "image.jpg",
        save_location: Annotated[str, Param(description="folder for the picture")] = "",
        focus: Annotated[
            int | None, Param(unit="1", minimum=0, maximum=255, description="empty: autofocus")
        ] = None,
        rotation: Annotated[float, Param(unit="°", description="turn the picture")] = 0.0,
    ) -> str:
        """Take a picture of the plate; the result is the picture's file."""
        return await self.device.grab_image(file_name, save_location, rotation)

    @action(Needs(), Reads(), duration_s=2, safe_to_repeat=True)
    async def read_barcode(self) -> dict[str, str]:
        """Read the label of the plate; the result is its ``barcode``, empty if there is none."""
        return {"barcode": await self.device.read_barcode()}
