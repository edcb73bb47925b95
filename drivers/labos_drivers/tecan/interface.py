"""What the Infinite offers."""

from __future__ import annotations

from typing import Annotated

from labos.node import Needs, Param, Requires, Sets, Station, action
from labos_drivers._simulation import Instrument
from labos_drivers.tecan.simulator import TecanSimulator

Wavelength = Annotated[float, Param(unit="nm", minimum=230, maximum=1000)]


class Tecan(Instrument):
    """Plate reader that measures spectra."""

    driver = "tecan"
    models = ("tecan", "tecan_infinite")
    stations = (Station("default", access={"gate": "open"}),)
    variables = {"gate": "open"}
    rest = {"gate": "open"}
    device: TecanSimulator

    async def connect(self) -> None:
        self.device = TecanSimulator(self.setup)

    @action(Sets("module", "gate", "open"), duration_s=10, safe_to_repeat=True, aliases=("open_lid", "open"))
    async def open_gate(self) -> None:
        """Bring the plate carrier out."""
        await self.device.open_gate()

    @action(
        Sets("module", "gate", "closed"), duration_s=10, safe_to_repeat=True, aliases=("close_lid", "close")
    )
    async def close_gate(self) -> None:
        """Take the plate carrier in."""
        await self.device.close_gate()

    @action(
        Needs(),
        Requires("labware", "lidded", False),
        Requires("module", "gate", "closed"),
        duration_s=350,
        aliases=("run_tecan",),
    )
    async def measure_sample(
        self,
        protocol_path: Annotated[str, Param(description="a method stored at the reader")] = "",
        start: Wavelength = 300.0,
        end: Wavelength = 1000.0,
        tecan_iteration: Annotated[int, Param(unit="1", minimum=0, description="numbers the file")] = 0,
    ) -> str:
        """Measure a spectrum of each well; the result is the file that the reader exported."""
        return await self.device.measure(protocol_path, start, end, tecan_iteration)
