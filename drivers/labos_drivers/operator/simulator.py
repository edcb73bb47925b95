"""A simulated person, who is sometimes late."""

from __future__ import annotations

import asyncio
from typing import Any

from labos.node import Setup
from labos_drivers._arm import Arm

USUAL, LATE = 0.6, 1.5
"""Of the nominal duration, so much is usually needed, and so much by somebody who is late."""


class OperatorSimulator(Arm):
    """A simulated person who carries plates. With ``alone: false`` in the configuration, this device does
    nothing by itself: the person who confirms the work moves the plates on the simulated bench. ``late`` is
    the share of work that is late (0 to 1)."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.alone = bool(self.config.get("alone", True))
        self.late = float(self.config.get("late", 0.2))

    async def wait_until_settled(self, settled: asyncio.Future[bool], nominal_s: float) -> None:
        """Wait until the simulated work is done, or until a person has reported its outcome before."""
        share = LATE if self._random.random() < self.late else USUAL
        working = asyncio.ensure_future(self.take_time(share * nominal_s))
        try:
            ends: set[asyncio.Future[Any]] = {working, settled}
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
        finally:
            working.cancel()

    def carry(self, source: str, target: str) -> None:
        self.world.grip(self.name, self.place(source))
        self._release_plate(target)

    def refill(self, module: str, resource: str) -> None:
        """Fill a resource of a device up to the largest amount that it was supplied with. The level of a
        resource that was never supplied stays unlimited."""
        device = module.rpartition("/")[2]
        left = self.world.find_level(device, resource) if device else None
        packs = [m for m in self.world.motions("supply") if m.place == device]
        full = [m.facts["amount"] for m in packs if m.facts["resource"] == resource]
        if left is not None and full:
            self.world.supply(device, resource, max(full) - left)
        self.work("replace", resource)

    def work(self, verb: str, what: str) -> None:
        self.world.work(self.name, verb, "", what=what)
