"""What the torture suite has to know of the camera."""

from __future__ import annotations

from labos.node import Fault, Torture, World
from labos_drivers.camera.wire import CameraOnWire


def _set_light(camera: CameraOnWire, world: World, *, off: bool) -> None:
    camera.is_dark = off


def _set_sensor(camera: CameraOnWire, world: World, *, hangs: bool) -> None:
    camera.is_frozen = hangs


def _set_sending(camera: CameraOnWire, world: World, *, fails: bool) -> None:
    camera.is_silent = fails


HERE = "labos_drivers.camera.source"

TORTURE = Torture(
    device=CameraOnWire,
    config=lambda address: {"source": address},
    faults=(
        Fault(
            "the light is off",
            lambda camera, world: _set_light(camera, world, off=True),
            lambda camera, world: _set_light(camera, world, off=False),
        ),
        Fault(
            "its sensor hangs",
            lambda camera, world: _set_sensor(camera, world, hangs=True),
            lambda camera, world: _set_sensor(camera, world, hangs=False),
        ),
        Fault(
            "a picture that never comes",
            lambda camera, world: _set_sending(camera, world, fails=True),
            lambda camera, world: _set_sending(camera, world, fails=False),
        ),
    ),
    motion="grab_image",
    waits={f"{HERE}:FRAME_S": 8.0, f"{HERE}:ANSWER_S": 3.0},
)
