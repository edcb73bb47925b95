"""A simulated Barty on the bench, without a wire."""

from __future__ import annotations

from typing import Any

from labos.node import DeviceError, Setup, World
from labos_drivers._simulation import Simulated
from labos_drivers.barty.protocol import ML_PER_S

PUMPS = range(4)
BEAKER_ML = 250.0
RESERVOIR_ML = 150.0


class Tanks:
    """Beakers and reservoirs, with one pump between each beaker and its reservoir. Their volumes (mL) follow
    from all motions so far. An empty beaker gives air. A full reservoir overflows."""

    def __init__(self, world: World, device: str) -> None:
        self._world, self._device = world, device
        self.beakers = dict.fromkeys(PUMPS, BEAKER_ML)
        self.reservoirs = dict.fromkeys(PUMPS, 0.0)
        for motion in world.motions("pump"):
            if motion.device == device:
                self._shift(motion.facts["pump"], motion.facts["ml"])

    def pump(self, pump: int, ml: float) -> None:
        """Pump a volume into a reservoir (negative: out of it), at most what is there. Raises Crash."""
        moved = max(-self.reservoirs[pump], min(ml, self.beakers[pump]))
        if self.reservoirs[pump] + moved > RESERVOIR_ML:
            self._world.crash(self._device, f"{self._device}.pump{pump}", "spills ink over the deck")
        self._shift(pump, moved)
        self._world.work(self._device, "pump", pump=pump, ml=moved)

    def _shift(self, pump: int, ml: float) -> None:
        self.beakers[pump] -= ml
        self.reservoirs[pump] += ml


class BartySimulator(Simulated):
    """Pumps that run for a time in proportion to the volume."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.tanks = Tanks(self.world, self.name)

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
                self.tanks.pump(pump, amount_ml)

    def observe(self) -> dict[str, Any]:
        """Nothing is reported: Barty has no sensor of level or flow."""
        return {}
