"""A simulated a4S sealer, without a wire."""

from __future__ import annotations

from labos_drivers._simulation import Simulated

USUAL_TIME_S = 3.0


class SealerSimulator(Simulated):
    """Draws the plate in, seals it and brings it out. It has no plate sensor, so it starts in any case."""

    drawers = ("default",)

    async def seal(self, time_s: float, temperature_c: float) -> None:
        nest = self.place("default")
        with self.motion(drawn_in=True):
            await self.take_time(11 + (time_s - USUAL_TIME_S))
            self.crash_if_sealed(nest, "seals a sealed plate")
            self.crash_if_lidded(nest, "seals a lid")
            self.world.use(self.name, "foil", 1)
            self.world.work(self.name, "seal", nest, time_s=time_s, temperature_c=temperature_c)
            await self.take_time(14)
