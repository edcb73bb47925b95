"""A simulated MiR on the bench."""

from __future__ import annotations

from typing import Any

from labos.node import Setup
from labos_drivers._simulation import Simulated


class MiRSimulator(Simulated):
    """The simulated base. Its deck is out of reach while it drives."""

    drawers = ("deck",)

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        drives = [motion for motion in self.world.motions("drive") if motion.device == self.name]
        self.position = drives[-1].facts["target"] if drives else ""

    async def move(self, target: str) -> None:
        await self._drive(target, 90)

    async def dock(self, target: str) -> None:
        await self._drive(target, 40)

    async def _drive(self, target: str, nominal_s: float) -> None:
        with self.motion(drawn_in=True):
            self.position = ""
            await self.take_time(nominal_s)
            self.world.work(self.name, "drive", target=target)
            self.position = target

    def observe(self) -> dict[str, Any]:
        return {"position": self.position}
