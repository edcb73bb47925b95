"""The node of the camera: its stations and actions."""

from __future__ import annotations

from typing import Annotated, Any

from labos.node import Attachment, Needs, Param, Reads, Setup, Station, action
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.camera.driver import CameraDriver
from labos_drivers.camera.simulator import CameraSimulator
from labos_drivers.camera.wire import CameraOnWire


class Camera(OnBenchOrWire):
    """Camera above a plate nest."""

    driver = "camera"
    models = ("camera", "camera (logitech)")
    stations = (Station("plate_station"),)
    devices = (CameraSimulator, CameraOnWire, CameraDriver)
    device: CameraSimulator | CameraDriver

    def __init__(self, setup: Setup) -> None:
        # Video devices are often named by a number, which YAML reads as an integer.
        source: Any = setup.config.get("source")
        if isinstance(source, int) and not isinstance(source, bool):
            setup.config = {**setup.config, "source": str(source)}
        super().__init__(setup)

    @action(Needs(), duration_s=5, safe_to_repeat=True, aliases=("take_picture",))
    async def grab_image(
        self,
        file_name: Annotated[str, Param(description="name of the picture")] = "image.jpg",
        save_location: Annotated[str, Param(description="folder for the picture")] = "",
        focus: Annotated[
            int | None, Param(unit="1", minimum=0, maximum=255, description="empty: autofocus")
        ] = None,
        rotation: Annotated[
            float,
            Param(unit="°", minimum=-360, maximum=360, description="turn the picture, against the clock"),
        ] = 0.0,
    ) -> Attachment:
        """Take a picture of the plate; the result is the picture's file."""
        if isinstance(self.device, CameraDriver):
            return await self.device.grab_image(file_name, save_location, rotation, focus)
        return await self.device.grab_image(file_name, save_location, rotation)

    @action(Needs(), Reads(), duration_s=2, safe_to_repeat=True)
    async def read_barcode(self) -> dict[str, str]:
        """Read the label of the plate; the result is its ``barcode``, empty if there is none."""
        return {"barcode": await self.device.read_barcode()}
