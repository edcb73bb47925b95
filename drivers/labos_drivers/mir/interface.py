"""What the MiR offers."""

from __future__ import annotations

from typing import Annotated

from labos.node import Param, Sets, Station, action
from labos_drivers._simulation import Instrument
from labos_drivers.mir.simulator import MiRSimulator

Position = Annotated[
    str, Param(aliases=("position", "location", "target_loc"), description="a position on the robot's map")
]


class MiR(Instrument):
    """Mobile base with a deck for labware."""

    driver = "mir"
    models = ("MiR250", "MiR100", "mir")
    stations = (Station("deck", kind="exchange", claim=False),)
    variables = {"position": ""}
    device: MiRSimulator

    async def connect(self) -> None:
        self.device = MiRSimulator(self.setup)

    @action(Sets("module", "position", "{target}"), duration_s=90, safe_to_repeat=True)
    async def move(self, target: Position) -> None:
        """Drive to a position."""
        await self.device.move(target)

    @action(Sets("module", "position", "{target}"), duration_s=40, safe_to_repeat=True)
    async def dock(self, target: Position) -> None:
        """Dock at a marker."""
        await self.device.dock(target)
