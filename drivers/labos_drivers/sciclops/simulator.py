"""A simulated SciClops."""

from __future__ import annotations

from labos.node import Setup
from labos_drivers._arm import Arm

TOWERS = tuple(f"tower{number}" for number in range(1, 6))
TOWER_HOLDS = 20


class SciclopsSimulator(Arm):
    """An arm that touches a tower from above to find its top. An empty tower is an error, not a crash."""

    transfer_s = 40.0

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.furnish(TOWER_HOLDS, *TOWERS)

    async def home(self) -> None:
        with self.motion():
            await self.take_time(30)

    async def get_plate(self, tower: str, target: str) -> None:
        if not self.world.at(self.place(tower)):
            with self.motion():
                await self.take_time(0.4 * self.transfer_s)
            raise self.make_refusal(f"{tower} is empty, the gripper touched the floor", "Refill the tower.")
        await self.transfer(tower, target)
