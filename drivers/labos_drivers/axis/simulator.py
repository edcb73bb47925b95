"""A simulated axis on the bench."""

from __future__ import annotations

from typing import Any, ClassVar

from labos.node import DeviceError, Setup
from labos_drivers._simulation import Simulated
from labos_drivers.axis.table import AxisTable

HOMES_S = 20.0


class AxisSimulator(Simulated):
    """An axis that moves to positions and reports its position."""

    table: ClassVar[AxisTable]

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.homed = self.table.absolute
        self._stands = self.table.home.position

    async def home(self) -> None:
        with self.motion():
            await self.take_time(HOMES_S)
            self.homed, self._stands = True, self.table.home.position
            self.world.work(self.name, "homes")

    async def move_to(self, position: float, speed: float) -> None:
        if not self.homed:
            raise DeviceError(
                f"{self.name} does not know where it is.", effects="none", remedy="Home it first."
            )
        with self.motion():
            await self.take_time(abs(position - self._stands) / speed)
            self._stands = position
            self.world.work(self.name, f"stands at {position:g}")

    def read_position(self) -> float:
        return self._stands

    def observe(self) -> dict[str, Any]:
        return {"homed": self.homed} | ({"position": self._stands} if self.homed else {})
