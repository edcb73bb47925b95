"""A simulated SOLO."""

from __future__ import annotations

from pathlib import Path

from labos_drivers._deck import Deck, make_facts
from labos_drivers.solo.protocol import find_dispensed

POSITIONS = tuple(f"Position{number}" for number in range(1, 9))


class SoloSimulator(Deck):
    """``liquids`` in its configuration has the liquid at each position from which protocols aspirate."""

    drawers = POSITIONS

    async def run_protocol(self, protocol: str) -> None:
        liquids = self.config.get("liquids") or {}
        dispensed = find_dispensed(self.read_text(protocol), liquids) if liquids else {}
        await self.pipette(300, protocol=protocol, **make_facts(dispensed))

    def read_text(self, protocol: str) -> str:
        """The text of a protocol; empty if there is no file with this name."""
        file = Path(protocol)
        return file.read_text("utf-8", "replace") if file.is_file() else ""
