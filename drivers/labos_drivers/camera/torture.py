"""The declaration of the camera for the torture suite."""

from __future__ import annotations

from labos.node import Fault, Torture
from labos_drivers.camera.wire import CameraOnWire

HERE = "labos_drivers.camera.source"

TORTURE = Torture(
    device=CameraOnWire,
    config=lambda address: {"source": address},
    faults=(
        Fault.by_setting("the light is off", "is_dark"),
        Fault.by_setting("its sensor hangs", "is_frozen"),
        Fault.by_setting("a picture that never comes", "is_silent"),
    ),
    motion="grab_image",
    waits={f"{HERE}:FRAME_S": 8.0, f"{HERE}:ANSWER_S": 3.0},
)
