"""The node of the XPeel: its stations and actions."""

from __future__ import annotations

from typing import Annotated, Any

from labos.node import Consumes, Needs, Param, Requires, Sets, Station, action
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.brooks_peeler.driver import PeelerDriver
from labos_drivers.brooks_peeler.simulator import PeelerSimulator
from labos_drivers.brooks_peeler.wire import PeelerOnWire


class BrooksPeeler(OnBenchOrWire):
    """Seal remover that pulls a seal off with adhesive tape."""

    driver = "brooks_peeler"
    models = ("brooks_xpeel", "brooks_peeler")
    stations = (Station("default"),)
    levels = {"tape": 600}
    devices = (PeelerSimulator, PeelerOnWire, PeelerDriver)
    device: PeelerSimulator | PeelerDriver

    async def resources(self) -> dict[str, float]:
        return await self.device.read_tape() if isinstance(self.device, PeelerDriver) else {}

    @action(
        Needs(),
        Requires("labware", "sealed", True),
        Requires("labware", "lidded", False),
        Sets("labware", "sealed", False),
        Consumes("tape", 1),
        duration_s=30,
        aliases=("peal",),
    )
    async def peel(
        self,
        parameter_set: Annotated[
            int, Param(unit="1", minimum=1, maximum=9, description="begin-peel position and speed")
        ] = 1,
        adhere: Annotated[
            float, Param(unit="s", choices=(2.5, 5.0, 7.5, 10.0), description="how long the tape is pressed")
        ] = 2.5,
    ) -> None:
        """Check that the plate in the nest is sealed, and take the seal off."""
        device = self.device
        if isinstance(device, PeelerSimulator):
            await device.peel(parameter_set, adhere)
            return
        with device.motion():
            await device.find_seal()
            command = device.make_peel_command(parameter_set, adhere)
            await self.note_handle(command)
            await device.peel(command)

    @action(duration_s=10, safe_to_repeat=True)
    async def sealcheck(self) -> str:
        """Look for a seal: ``sealed``, ``unsealed`` or ``no plate``."""
        return await self.device.sealcheck()

    async def take_up(self, name: str, handle: str) -> Any:
        """Check the result of a peel in the device's record of its last motion. Nothing is started."""
        if name != "peel" or not isinstance(self.device, PeelerDriver):
            return await super().take_up(name, handle)
        return await self.device.follow(handle)
