"""The node of the Infinite: its stations and actions."""

from __future__ import annotations

from typing import Annotated

from labos.node import Attachment, Needs, Param, Requires, Sets, Station, action
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.tecan.driver import TecanDriver
from labos_drivers.tecan.simulator import TecanSimulator
from labos_drivers.tecan.wire import TecanOnWire

Wavelength = Annotated[float, Param(unit="nm", minimum=230, maximum=1000)]


class Tecan(OnBenchOrWire):
    """Plate reader that measures spectra."""

    driver = "tecan"
    models = ("tecan", "tecan_infinite")
    stations = (Station("default", access={"gate": "open"}),)
    variables = {"gate": "open"}
    rest = {"gate": "open"}
    devices = (TecanSimulator, TecanOnWire, TecanDriver)
    device: TecanSimulator | TecanDriver

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
        step: Annotated[float, Param(unit="nm", minimum=0.1, maximum=770)] = 20.0,
        wells: Annotated[int, Param(unit="1", choices=(96, 384))] = 96,
    ) -> Attachment:
        """Measure a spectrum of each well; the result is the file that the reader exported."""
        name = f"{self.setup.name}_{tecan_iteration}.asc"
        return await self.device.measure(protocol_path, start, end, step, wells, name)

    @action(Sets("module", "gate", "open"), duration_s=20, recovers=True)
    async def reset(self) -> None:
        """Initialise the reader; its carrier comes out."""
        await super().reset()
