"""What the torture suite has to know beside the description: examples, and how the device is made to fail."""

from __future__ import annotations

from labos.node import Case, Fault, Torture, World
from PACKAGE.simulator import Device


def _block(device: Device, world: World) -> None:
    device.is_blocked = True


def _free(device: Device, world: World) -> None:
    device.is_blocked = False


def _take_away(device: Device, world: World) -> None:
    for plate in world.at(device.place("nest")):
        world.carry(plate, "")


TORTURE = Torture(
    device=Device,
    cases=(Case("work", {"time": 10.0}, record=lambda args: {"time_s": args["time"]}),),
    faults=(Fault("its drive is jammed", _block, _free), Fault("no plate in the nest", _take_away)),
    # Motions take one second here, so that the tests are fast.
    waits={"PACKAGE.driver:MOTION_S": 6.0},
)
