"""The node of the MiR: its station and actions."""

from __future__ import annotations

from typing import Annotated

from labos.node import Param, Sets, Station, action
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.mir.driver import MiRDriver
from labos_drivers.mir.simulator import MiRSimulator
from labos_drivers.mir.wire import MiROnWire

Position = Annotated[
    str, Param(aliases=("position", "location", "target_loc"), description="a position on the robot's map")
]


class MiR(OnBenchOrWire):
    """Mobile base with a deck for labware."""

    driver = "mir"
    models = ("MiR250", "MiR100", "mir")
    stations = (Station("deck", kind="exchange", claim=False),)
    variables = {"position": ""}
    follows = ("move", "dock")
    devices = (MiRSimulator, MiROnWire, MiRDriver)
    device: MiRSimulator | MiRDriver

    @action(Sets("module", "position", "{target}"), duration_s=90, safe_to_repeat=True)
    async def move(self, target: Position) -> None:
        """Drive to a position."""
        await self.device.move(target)

    @action(Sets("module", "position", "{target}"), duration_s=40, safe_to_repeat=True)
    async def dock(self, target: Position) -> None:
        """Dock at a marker."""
        await self.device.dock(target)
