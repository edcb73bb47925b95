"""A simulated Hidex Sense."""

from __future__ import annotations

from labos.node import Setup
from labos_drivers._simulation import Gated


class HidexSimulator(Gated):
    """Reads what is on its carrier."""

    gate_s = 10.0

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.reads = 0

    async def run_assay(self, assay: str) -> str:
        with self.motion():
            self.needs_closed()
            await self.take_time(300)
            self.world.work(self.name, "read", self.place("default"), assay=assay)
            self.reads += 1
            return f"{assay}_{self.reads:04}.csv"
