"""The node of the UR arm: its stations and actions."""

from __future__ import annotations

from typing import Annotated

from labos.node import Move, Param, Place, Station, action
from labos_drivers._arm import GRIPPER, SOURCE, TARGET
from labos_drivers.ur.driver import URDriver
from labos_drivers.ur.pendant import AWAY, BARE, PendantDrop
from labos_drivers.ur.simulator import URSimulator
from labos_drivers.ur.wire import UROnWire

ProgramName = Annotated[
    str,
    Param(aliases=("program", "transfer_file_path"), description="a .urp program stored in the controller"),
]


class UR(PendantDrop):
    """Six-axis arm with a gripper, or with a pipette in its place."""

    driver = "ur"
    models = ("ur5", "ur3", "ur5e", "ur3e", "ur")
    manipulator = True
    stations = (Station("gripper", kind="gripper"),)
    devices = (URSimulator, UROnWire, URDriver)
    device: URSimulator | URDriver

    @action(AWAY, BARE, Move(SOURCE, TARGET), duration_s=45)
    async def transfer(self, source: Place, target: Place, program_name: ProgramName = "") -> None:
        """Carry labware from one station to another, by a stored program if one is named."""
        if isinstance(self.device, URDriver):
            await self.device.transfer(source, target, program_name)
        else:
            await self.device.transfer(source, target)

    @action(AWAY, BARE, Move(SOURCE, GRIPPER), duration_s=27)
    async def pick(self, source: Place) -> None:
        """Take labware into the hand; the arm carries nothing else until it has put that down."""
        await self.device.pick(source)

    @action(AWAY, BARE, Move(GRIPPER, TARGET), duration_s=27, aliases=("place",))
    async def put_down(self, target: Place) -> None:
        """Put down what the hand holds: what was picked, or what an interrupted transfer left."""
        await self.device.put_down(target)

    @action(AWAY, duration_s=60)
    async def run_urp_program(self, program_name: ProgramName) -> None:
        """Run a stored program that carries no labware; for one that does, use ``transfer``."""
        await self.device.run_program(program_name)
