"""The node of the PlateCrane: its stations and actions."""

from __future__ import annotations

from typing import Annotated

from labos.node import Move, Param, Place, Relid, Station, Unlid, action
from labos_drivers._arm import GRIPPER, SOURCE, TARGET
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.platecrane.driver import HEIGHT_OFFSETS, PlateCraneDriver
from labos_drivers.platecrane.simulator import STACKS, PlateCraneSimulator
from labos_drivers.platecrane.wire import PlateCraneOnWire

Kind = Annotated[
    str, Param(choices=("", "stack", "module", "nest"), description="how the place is approached")
]
PlateType = Annotated[str, Param(description="a plate type known to the crane")]


class PlateCrane(OnBenchOrWire):
    """Plate arm among stacks and nests."""

    driver = "platecrane"
    models = ("platecrane", "hudson_platecrane")
    manipulator = True
    stations = (
        *(Station(stack, kind="stack", capacity=20, claim=False) for stack in STACKS),
        *(Station(f"LidNest{number}", claim=False) for number in range(1, 4)),
        Station("gripper", kind="gripper"),
    )
    devices = (PlateCraneSimulator, PlateCraneOnWire, PlateCraneDriver)
    device: PlateCraneSimulator | PlateCraneDriver

    @action(Move(SOURCE, TARGET), duration_s=60)
    async def transfer(
        self,
        source: Place,
        target: Place,
        source_type: Kind = "",
        target_type: Kind = "",
        plate_type: PlateType = "96_well",
        height_offset: Annotated[
            int,
            Param(
                unit="steps",
                minimum=HEIGHT_OFFSETS[0],
                maximum=HEIGHT_OFFSETS[1],
                description="raises the grip; Z is counted in motor steps",
            ),
        ] = 0,
    ) -> None:
        """Carry a plate from one station to another."""
        if isinstance(self.device, PlateCraneDriver):
            await self.device.transfer(source, target, float(height_offset))
        else:
            await self.device.transfer(source, target)

    @action(Move(GRIPPER, TARGET), duration_s=36)
    async def put_down(self, target: Place) -> None:
        """Put down the plate that an interrupted transfer left in the hand."""
        await self.device.put_down(target)

    @action(Unlid(SOURCE, TARGET), duration_s=60)
    async def remove_lid(self, source: Place, target: Place, plate_type: PlateType = "96_well") -> None:
        """Take the lid off the plate at ``source`` and put it into the nest ``target``."""
        await self.device.remove_lid(source, target)

    @action(Relid(SOURCE, TARGET), duration_s=60)
    async def replace_lid(self, source: Place, target: Place, plate_type: PlateType = "96_well") -> None:
        """Put the lid from the nest ``source`` onto the plate at ``target``."""
        await self.device.replace_lid(source, target)
