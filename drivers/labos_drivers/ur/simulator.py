"""A simulated UR arm, without a wire."""

from __future__ import annotations

from typing import Any

from labos.node import Setup
from labos_drivers._arm import Arm
from labos_drivers.ur.rig import Rig

PENDANT_S = 50.0


class URSimulator(Arm):
    """An arm with a gripper, and with a dock from which it can fetch a pipette. ``falls`` in its
    configuration is the probability that a drop falls off the tip (0 to 1)."""

    transfer_s = 45.0

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.rig = Rig(self.world, self.name)

    async def run_program(self, program: str) -> None:
        with self.motion():
            await self.take_time(60)
            self.world.work(self.name, "program", program=program)

    async def pendant(self, action: str, plate: str = "", **facts: Any) -> None:
        """Carry out an action of the pendant drop experiment."""
        if action == "run_droplet" and self._random.random() < float(self.config.get("falls", 0.0)):
            facts["fell"] = True
        with self.motion():
            if plate:
                self.world.enter(self.name, self.place(plate))
            await self.take_time(0.5 * PENDANT_S)
            self.rig.do(action, self.place(plate) if plate else "", **facts)
            await self.take_time(0.5 * PENDANT_S)

    def observe(self) -> dict[str, Any]:
        return super().observe() | self.rig.read_sensors(self.config.get("pendant") or {})
