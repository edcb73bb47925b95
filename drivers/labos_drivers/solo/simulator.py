"""A simulated SOLO."""

from __future__ import annotations

from pathlib import Path

from labos_drivers._deck import Deck, facts_of
from labos_drivers.solo.protocol import dispensed_by

POSITIONS = tuple(f"Position{number}" for number in range(1, 9))


class SoloSimulator(Deck):
    """``liquids`` in its configuration says what stands at positions that are no stations of the lab."""

    drawers = POSITIONS

    async def run_protocol(self, protocol: str) -> None:
        liquids = self.config.get("liquids") or {}
        dispensed = dispensed_by(self.text_of(protocol), liquids) if liquids else {}
        await self.pipette(300, protocol=protocol, **facts_of(dispensed))

    def text_of(self, protocol: str) -> str:
        """What the protocol says; nothing, if it is only a name."""
        file = Path(protocol)
        return file.read_text("utf-8", "replace") if file.is_file() else ""
