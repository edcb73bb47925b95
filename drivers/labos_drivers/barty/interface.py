"""The actions of Barty."""

from __future__ import annotations

import re
from typing import Annotated

from labos.node import DeviceError, Param, action
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.barty.driver import LEAST_ML, MOST_ML, BartyDriver, check_dose
from labos_drivers.barty.simulator import BartySimulator
from labos_drivers.barty.wire import BartyOnWire

Amount = Annotated[float, Param(unit="mL", minimum=LEAST_ML, maximum=MOST_ML, aliases=("volume",))]
Pumps = Annotated[list[int], Param(description="pumps by number, 0 to 3")]
ALL = [0, 1, 2, 3]


class Barty(OnBenchOrWire):
    """Four peristaltic pumps that keep a liquid handler's ink reservoirs full."""

    driver = "barty"
    models = ("RPL BARTY", "barty")
    follows = ("fill", "drain", "fill_all", "drain_all", "refill_ink")
    devices = (BartySimulator, BartyOnWire, BartyDriver)
    device: BartySimulator | BartyDriver

    @action(duration_s=3.5)
    async def fill(self, pumps: Pumps, amount: Amount = 5.0) -> None:
        """Pump ink into the reservoirs of some pumps."""
        check_dose(self.setup.name, pumps, amount)
        await self.device.fill(pumps, amount)

    @action(duration_s=3.5)
    async def drain(self, pumps: Pumps, amount: Amount = 5.0) -> None:
        """Pump ink back from the reservoirs of some pumps."""
        check_dose(self.setup.name, pumps, amount)
        await self.device.drain(pumps, amount)

    @action(duration_s=42, aliases=("fill_ink_all_motors",))
    async def fill_all(self, amount: Amount = 60.0) -> None:
        """Pump ink into every reservoir."""
        await self.device.fill(ALL, amount)

    @action(duration_s=70, aliases=("drain_ink_all_motors",))
    async def drain_all(self, amount: Amount = 100.0) -> None:
        """Pump ink back from every reservoir."""
        await self.device.drain(ALL, amount)

    @action(duration_s=3.5)
    async def refill_ink(
        self,
        motors: Annotated[list[str], Param(description="motor_1 to motor_4")],
        amount: Amount = 5.0,
    ) -> None:
        """Pump ink into the reservoirs of some pumps, named as motors."""
        pumps = [self._pump_of(motor) for motor in motors]
        check_dose(self.setup.name, pumps, amount)
        await self.device.fill(pumps, amount)

    def _pump_of(self, motor: str) -> int:
        if not isinstance(motor, str) or not re.fullmatch(r"motor_[1-4]", motor):
            raise DeviceError(
                f"{self.setup.name} has no motor {motor!r}.",
                effects="none",
                remedy="Use motor_1 to motor_4.",
            )
        return int(motor[-1]) - 1
