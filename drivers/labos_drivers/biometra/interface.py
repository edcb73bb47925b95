"""The node of the TRobot: its station, its lid and its actions."""

from __future__ import annotations

from typing import Annotated

from labos.node import Needs, Param, Requires, Sets, Station, action
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.biometra.driver import LARGEST_PROGRAM, BiometraDriver
from labos_drivers.biometra.simulator import BiometraSimulator
from labos_drivers.biometra.wire import BiometraOnWire


class Biometra(OnBenchOrWire):
    """Thermal cycler with a motorised, heated lid."""

    driver = "biometra"
    models = ("biometra", "biometra (96well)", "biometra (192well)")
    stations = (Station("default", access={"lid": "open"}),)
    variables = {"lid": "open"}
    rest = {"lid": "open"}
    follows = ("open_lid", "close_lid", "run_program")
    devices = (BiometraSimulator, BiometraOnWire, BiometraDriver)
    device: BiometraSimulator | BiometraDriver

    @action(Sets("module", "lid", "open"), duration_s=20, safe_to_repeat=True)
    async def open_lid(self) -> None:
        """Open the lid."""
        await self.device.open_gate()

    @action(Sets("module", "lid", "closed"), duration_s=20, safe_to_repeat=True)
    async def close_lid(self) -> None:
        """Close the lid."""
        await self.device.close_gate()

    @action(
        Needs(),
        Requires("labware", "lidded", False),
        Requires("module", "lid", "closed"),
        duration_s=5400,
        aliases=("run_protocol", "thermocycle"),
    )
    async def run_program(
        self,
        program_n: Annotated[
            int,
            Param(
                unit="1",
                minimum=0,
                maximum=LARGEST_PROGRAM,
                aliases=("program", "program_number", "prog"),
                description="number of a program stored in the cycler",
            ),
        ],
    ) -> None:
        """Run a stored program to its end; the lid must be closed."""
        await self.device.run_program(program_n)
