"""A simulated TRobot."""

from __future__ import annotations

from labos_drivers._simulation import Gated


class BiometraSimulator(Gated):
    """A thermal block under a motorised lid."""

    async def run_program(self, number: int) -> None:
        block = self.place("default")
        with self.motion():
            self.check_closed()
            self.crash_if_lidded(block, "heats a lid")
            self.world.work(self.name, "heat", block, program=number)
            await self.take_time(5400)
            self.world.work(self.name, "cycle", block, program=number)
