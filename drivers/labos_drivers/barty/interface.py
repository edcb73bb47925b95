"""What Barty offers."""

from __future__ import annotations

from typing import Annotated

from labos.node import Param, action
from labos_drivers._simulation import Instrument
from labos_drivers.barty.simulator import BartySimulator

Amount = Annotated[float, Param(unit="mL", minimum=0, maximum=150, aliases=("volume",))]
Pumps = Annotated[list[int], Param(description="pumps by number, 0 to 3")]


class Barty(Instrument):
    """Four peristaltic pumps that keep a liquid handler's ink reservoirs full."""

    driver = "barty"
    models = ("RPL BARTY", "barty")
    device: BartySimulator

    async def connect(self) -> None:
        self.device = BartySimulator(self.setup)

    @action(duration_s=3.5)
    async def fill(self, pumps: Pumps, amount: Amount = 5.0) -> None:
        """Pump ink into the reservoirs of some pumps."""
        await self.device.fill(pumps, amount)

    @action(duration_s=3.5)
    async def drain(self, pumps: Pumps, amount: Amount = 5.0) -> None:
        """Pump ink back from the reservoirs of some pumps."""
        await self.device.drain(pumps, amount)

    @action(duration_s=42, aliases=("fill_ink_all_motors",))
    async def fill_all(self, amount: Amount = 60.0) -> None:
        """Pump ink into every reservoir."""
        await self.device.fill([0, 1, 2, 3], amount)

    @action(duration_s=70, aliases=("drain_ink_all_motors",))
    async def drain_all(self, amount: Amount = 100.0) -> None:
        """Pump ink back from every reservoir."""
        await self.device.drain([0, 1, 2, 3], amount)

    @action(duration_s=3.5)
    async def refill_ink(
        self,
        motors: Annotated[list[str], Param(description="motor_1 to motor_4")],
        amount: Amount = 5.0,
    ) -> None:
        """Pump ink into the reservoirs of some pumps, named as motors."""
        await self.device.fill([int(motor.rpartition("_")[2]) - 1 for motor in motors], amount)
