"""A simulated SOLO."""

from __future__ import annotations

from labos_drivers._deck import Deck

POSITIONS = tuple(f"Position{number}" for number in range(1, 9))


class SoloSimulator(Deck):
    drawers = POSITIONS

    async def run_protocol(self, protocol: str) -> None:
        await self.pipette(300, protocol=protocol)
