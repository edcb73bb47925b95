"""A simulated SOLO."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from labos_drivers._deck import Deck, facts_of
from labos_drivers.solo.protocol import dispensed_by

POSITIONS = tuple(f"Position{number}" for number in range(1, 9))


class SoloSimulator(Deck):
    """``liquids`` in its configuration says what stands at positions that are no stations of the lab."""

    drawers = POSITIONS

    async def run_protocol(self, protocol: str) -> None:
        await self.pipette(300, protocol=protocol, **self._dispensed(Path(protocol)))

    def _dispensed(self, file: Path) -> dict[str, Any]:
        liquids = self.config.get("liquids")
        if not liquids or not file.is_file():
            return {}
        return facts_of(dispensed_by(file.read_text("utf-8", "replace"), liquids))
