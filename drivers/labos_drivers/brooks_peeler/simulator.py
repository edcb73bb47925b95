"""A simulated XPeel."""

from __future__ import annotations

from labos_drivers._simulation import Simulated

USUAL_ADHERE_S = 2.5


class PeelerSimulator(Simulated):
    """Has a plate sensor and a reflective seal sensor at the same position of the conveyor."""

    drawers = ("default",)

    async def peel(self, parameter_set: int, adhere_s: float) -> None:
        with self.motion(drawn_in=True):
            await self.take_time(10)
            match self._read_seal_sensor():
                case "no plate":
                    raise self.make_refusal("XPeel error 06: no plate found", "Look where the plate is.")
                case "unsealed":
                    raise self.make_refusal(
                        "XPeel seal check 00: no seal on the plate", "Look at the plate before going on."
                    )
            self.crash_if_lidded(self.place("default"), "peels a lid")
            await self.take_time(10 + adhere_s - USUAL_ADHERE_S)
            self.world.use(self.name, "tape", 1)
            self.world.work(self.name, "peel", self.place("default"), set=parameter_set, adhere_s=adhere_s)
            await self.take_time(10)

    async def sealcheck(self) -> str:
        with self.motion(drawn_in=True):
            await self.take_time(10)
            return self._read_seal_sensor()

    def _read_seal_sensor(self) -> str:
        plate = self.top(self.place("default"))
        if not plate:
            return "no plate"
        return "sealed" if self.is_sealed(plate) else "unsealed"
