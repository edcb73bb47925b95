"""A simulated SWING. All durations are invented: none are published."""

from __future__ import annotations

from labos_drivers._simulation import Gated


class ChemspeedSimulator(Gated):
    """A platform that makes its samples with or without a plate from outside."""

    gate_s = 6.0

    async def run_program(self, program: str) -> None:
        with self.motion():
            self.needs_closed()
            await self.take_time(3600)
            place = self.place("default")
            self.world.work(self.name, "synthesise", place if self.top(place) else "", program=program)
