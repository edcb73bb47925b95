"""The actions of the Hidex."""

from __future__ import annotations

from typing import Annotated, Any

from labos.node import Needs, Param, Requires, Sets, Station, action
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.hidex.driver import HidexDriver
from labos_drivers.hidex.simulator import HidexSimulator
from labos_drivers.hidex.wire import HidexOnWire


class Hidex(OnBenchOrWire):
    """Plate reader; its lid is the plate carrier, open when it is out."""

    driver = "hidex"
    models = ("Hidex", "hidex")
    stations = (Station("default", access={"lid": "open"}),)
    variables = {"lid": "open"}
    rest = {"lid": "open"}
    follows = ("open_lid", "close_lid", "run_assay", "read_plate")
    devices = (HidexSimulator, HidexOnWire, HidexDriver)
    device: HidexSimulator | HidexDriver

    async def take_up(self, name: str, handle: str) -> Any:
        result = await super().take_up(name, handle)
        return self.device.parse_result(name, result) if isinstance(self.device, HidexDriver) else result

    @action(Sets("module", "lid", "open"), duration_s=10, safe_to_repeat=True, aliases=("open",))
    async def open_lid(self) -> None:
        """Bring the plate carrier out."""
        await self.device.open_gate()

    @action(Sets("module", "lid", "closed"), duration_s=10, safe_to_repeat=True, aliases=("close",))
    async def close_lid(self) -> None:
        """Take the plate carrier in."""
        await self.device.close_gate()

    @action(
        Needs(),
        Requires("labware", "lidded", False),
        Requires("module", "lid", "closed"),
        duration_s=300,
        aliases=("run_protocol",),
    )
    async def run_assay(
        self,
        assay_name: Annotated[
            str, Param(aliases=("assay", "protocol_path"), description="a template stored in the reader")
        ],
    ) -> str:
        """Read the plate; the result is the file that the reader exported."""
        return await self.device.run_assay(assay_name)

    @action(
        Needs(), Requires("labware", "lidded", False), Requires("module", "lid", "closed"), duration_s=300
    )
    async def read_plate(
        self,
        assay_name: Annotated[
            str, Param(aliases=("assay", "protocol_path"), description="a template stored in the reader")
        ],
    ) -> dict[str, Any]:
        """Read the plate; the result is a table: the quantity, its unit, a value for each well."""
        return await self.device.read_plate(assay_name)
