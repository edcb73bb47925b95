"""A simulated OT-2."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from labos.node import DeviceError, Setup
from labos_drivers._deck import Deck

SLOTS = (*(f"deck{number}" for number in range(1, 12)), "deck1_cooler")

COLUMN = 8
"""Tips that the pipette picks up at once."""


class OT2Simulator(Deck):
    """A gantry that forgets its runs when the power goes."""

    drawers = SLOTS

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.runs = 0

    async def run_protocol(
        self,
        protocol: str,
        volumes: dict[str, list[float]],
        wells: list[str],
        drawn: dict[str, float],
        variables: dict[str, Any],
    ) -> dict[str, Any]:
        """Run it, and answer with the robot's own name for the run."""
        tips = min(len(wells), COLUMN)  # what it does beyond the wells that it is told is not simulated
        facts = {
            "protocol": _sha256(protocol),
            "volumes": volumes,
            "wells": wells,
            "drawn": drawn,
            "values": variables,
        }
        for liquid, doses in volumes.items():
            if self.world.left(self.name, liquid) is not None:
                self.world.use(self.name, liquid, sum(doses))
        await self.pipette(600, tips=tips, **facts)
        self.runs += 1
        return {"run": f"{self.name}-{self.runs}", "status": "succeeded"}

    async def resume_run(self) -> None:
        """A simulated gantry waits for nobody."""
        raise DeviceError(f"{self.name}: no run waits.", effects="none")


def _sha256(protocol: str) -> str:
    """What the robot was really given; a protocol that is only a name is told as it is."""
    path = Path(protocol)
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else protocol
