"""What NAME offers: actions, their arguments and limits, and what they do to the bench."""

from __future__ import annotations

import asyncio
from typing import Annotated, Any

from labos.node import DeviceError, Needs, Node, Param, Station, action
from PACKAGE.driver import Driver
from PACKAGE.simulator import Device


class CLASS(Node):
    """An instrument that works on the plate in its nest."""

    driver = "NAME"
    models = ("NAME",)
    stations = (Station("nest"),)
    simulated: Device | None = None

    async def connect(self) -> None:
        self.device = Driver(self.setup.name, self._port())
        await asyncio.to_thread(self.device.open)

    def _port(self) -> str:
        """That of the instrument; in a simulated lab (`labos up --simulate`) that of a simulated one."""
        if self.setup.world is None:
            return str(self.setup.setting("port", "/dev/serial/by-id/…"))
        if self.simulated is None:
            self.simulated = Device(self.setup)
            self.simulated.start()
        return self.simulated.address

    async def close(self) -> None:
        if hasattr(self, "device"):
            self.device.close()
        if self.simulated is not None:
            await asyncio.to_thread(self.simulated.close)
            self.simulated = None

    async def is_idle(self) -> bool:
        return await asyncio.to_thread(self.device.is_idle)

    async def reset(self) -> None:
        await asyncio.to_thread(self.device.reset)

    async def stop(self) -> None:
        raise DeviceError("It cannot be stopped over its line.", remedy="Use the switch on the device.")

    async def observe(self) -> dict[str, Any]:
        """What it sees: it has a sensor under its nest."""
        return {"labware": {"nest": await asyncio.to_thread(self.device.sees_a_plate)}}

    # A plain method may block: LabOS calls it in a thread of its own.
    @action(Needs("nest"), duration_s=10)
    def work(
        self, time: Annotated[float, Param(unit="s", minimum=1, maximum=60, description="how long")] = 10.0
    ) -> None:
        """Work on the plate in the nest."""
        self.device.work(time)
