"""A simulated UR arm."""

from __future__ import annotations

from labos_drivers._arm import Arm


class URSimulator(Arm):
    transfer_s = 45.0

    async def run_program(self, program: str) -> None:
        with self.motion():
            await self.take_time(60)
            self.world.work(self.name, "program", program=program)
