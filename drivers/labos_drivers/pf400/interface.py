"""What the PF400 offers."""

from __future__ import annotations

from typing import Annotated

from labos.node import Move, Param, Place, Relid, Station, Unlid, action
from labos_drivers._arm import GRIPPER, SOURCE, TARGET
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.pf400.driver import PF400Driver
from labos_drivers.pf400.simulator import PF400Simulator
from labos_drivers.pf400.wire import PF400OnWire

Grip = Annotated[
    str,
    Param(
        choices=("", "narrow", "wide"),
        description="side of the plate the fingers close on; empty: as taught",
    ),
]


Slow = Annotated[bool, Param(description="at a crawl, as on the first move to a newly taught place")]


class PF400(OnBenchOrWire):
    """Four-axis plate arm on a rail."""

    driver = "pf400"
    models = ("pf400",)
    manipulator = True
    stations = (Station("gripper", kind="gripper"),)
    devices = (PF400Simulator, PF400OnWire, PF400Driver)
    device: PF400Simulator | PF400Driver

    @action(
        Move(SOURCE, TARGET, "{source_plate_rotation}", "{target_plate_rotation}"),
        duration_s=30,
        aliases=("move",),
    )
    async def transfer(
        self,
        source: Place,
        target: Place,
        source_plate_rotation: Grip = "",
        target_plate_rotation: Grip = "",
        slow: Slow = False,
    ) -> None:
        """Carry a plate from one station to another."""
        await self.device.carry(source, target, source_plate_rotation, target_plate_rotation, slow=slow)

    @action(Move(GRIPPER, TARGET, target_grip="{target_plate_rotation}"), duration_s=18)
    async def put_down(self, target: Place, target_plate_rotation: Grip = "") -> None:
        """Put down the plate that an interrupted transfer left in the hand."""
        await self.device.put_down(target)

    @action(Unlid(SOURCE, TARGET, "{source_plate_rotation}", "{target_plate_rotation}"), duration_s=30)
    async def remove_lid(
        self, source: Place, target: Place, source_plate_rotation: Grip = "", target_plate_rotation: Grip = ""
    ) -> None:
        """Take the lid off the plate at ``source`` and put it into the nest ``target``."""
        await self.device.unlid(source, target, source_plate_rotation, target_plate_rotation)

    @action(Relid(SOURCE, TARGET, "{source_plate_rotation}", "{target_plate_rotation}"), duration_s=30)
    async def replace_lid(
        self, source: Place, target: Place, source_plate_rotation: Grip = "", target_plate_rotation: Grip = ""
    ) -> None:
        """Put the lid from the nest ``source`` onto the plate at ``target``."""
        await self.device.relid(source, target, source_plate_rotation, target_plate_rotation)

    @action(duration_s=60, safe_to_repeat=True)
    async def explore_workcell(self) -> None:
        """Visit the taught locations with an empty hand."""
        await self.device.explore()
