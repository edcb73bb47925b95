"""A simulated Barty."""

from __future__ import annotations

from typing import Any

from labos.node import DeviceError, Setup
from labos_drivers._simulation import Simulated

ML_PER_S = 1.427
PUMPS = range(4)
BEAKER_ML = 250.0
RESERVOIR_ML = 150.0


class BartySimulator(Simulated):
    """Pumps that run for a time: a dry beaker gives air, a full reservoir overflows."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.beakers = dict.fromkeys(PUMPS, BEAKER_ML)
        self.reservoirs = dict.fromkeys(PUMPS, 0.0)
        for motion in self.world.motions("pump"):
            if motion.device == self.name:
                self._shift(motion.facts["pump"], motion.facts["ml"])

    async def fill(self, pumps: list[int], amount_ml: float) -> None:
        await self._run(pumps, amount_ml)

    async def drain(self, pumps: list[int], amount_ml: float) -> None:
        await self._run(pumps, -amount_ml)

    async def _run(self, pumps: list[int], amount_ml: float) -> None:
        if unknown := [pump for pump in pumps if pump not in PUMPS]:
            raise DeviceError(f"{self.name} has no pump {unknown[0]}.", effects="none", remedy="Use 0 to 3.")
        with self.motion():
            await self.take_time(abs(amount_ml) / ML_PER_S)
            for pump in pumps:
                moved = max(-self.reservoirs[pump], min(amount_ml, self.beakers[pump]))
                if self.reservoirs[pump] + moved > RESERVOIR_ML:
                    self.world.crash(self.name, self.place(f"pump{pump}"), "spills ink over the deck")
                self._shift(pump, moved)
                self.world.work(self.name, "pump", pump=pump, ml=moved)

    def _shift(self, pump: int, ml: float) -> None:
        self.beakers[pump] -= ml
        self.reservoirs[pump] += ml

    def observe(self) -> dict[str, Any]:
        """Nothing: Barty has no sensor of level or flow."""
        return {}
