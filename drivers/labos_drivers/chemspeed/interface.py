"""What the Chemspeed offers."""

from __future__ import annotations

from typing import Annotated

from labos.node import Param, Requires, Sets, Station, action
from labos_drivers.chemspeed.driver import ChemspeedDriver
from labos_drivers.chemspeed.simulator import ChemspeedSimulator
from labos_drivers.chemspeed.wire import ChemspeedOnWire
from labos_drivers.gateway.driver import BehindGateway


class Chemspeed(BehindGateway):
    """Synthesis platform under a hood."""

    driver = "chemspeed"
    models = ("chemspeed", "chemspeed_swing")
    stations = (Station("default", access={"lid": "open"}),)
    variables = {"lid": "open"}
    rest = {"lid": "open"}
    devices = (ChemspeedSimulator, ChemspeedOnWire, ChemspeedDriver)
    device: ChemspeedSimulator | ChemspeedDriver

    @action(
        Sets("module", "lid", "open"), duration_s=6, safe_to_repeat=True, aliases=("open", "open_chemspeed")
    )
    async def open_lid(self) -> None:
        """Open the hood."""
        await self.device.open_gate()

    @action(
        Sets("module", "lid", "closed"),
        duration_s=6,
        safe_to_repeat=True,
        aliases=("close", "close_chemspeed"),
    )
    async def close_lid(self) -> None:
        """Close the hood."""
        await self.device.close_gate()

    @action(Requires("module", "lid", "closed"), duration_s=3600, aliases=("run_protocol", "run_chemspeed"))
    async def run_program(
        self,
        program: Annotated[
            str, Param(aliases=("name_protocol", "program_name"), description="an AutoSuite program")
        ],
    ) -> None:
        """Run a program to its end; the hood must be closed."""
        await self.device.run_program(program)
