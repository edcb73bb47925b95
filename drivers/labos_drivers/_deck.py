"""A simulated device whose gantry moves pipettes over a deck."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from labos_drivers._simulation import Simulated


def make_facts(dispensed: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    """The volumes that are dispensed into wells (µL by liquid and well), in the form of the facts of a motion
    of the bench; empty if there are none."""
    wells = sorted({well for doses in dispensed.values() for well in doses})
    volumes = {liquid: [doses.get(well, 0.0) for well in wells] for liquid, doses in dispensed.items()}
    return {"volumes": volumes, "wells": wells} if wells else {}


class Deck(Simulated):
    """Pipettes over a deck. While the gantry moves, no other hand may be there."""

    async def pipette(self, nominal_s: float, *, tips: float = 8, **facts: Any) -> None:
        """Work on every plate on the deck, and use up this number of tips (by default, a column of 8)."""
        with self.motion(drawn_in=True):
            slots = self._find_plates()
            if tips:
                self.world.use(self.name, "tips", tips)
            await self.take_time(0.5 * nominal_s)
            for slot in slots:
                self.world.work(self.name, "pipette", slot, **facts)
            await self.take_time(0.5 * nominal_s)

    def _find_plates(self) -> list[str]:
        slots = [slot for slot in map(self.place, self.drawers) if self.world.at(slot)]
        if not slots:
            self.world.crash(self.name, self.place(self.drawers[0]), "pipettes into nothing")
        for slot in slots:
            self.crash_if_sealed(slot, "drives its tips into a seal")
            self.crash_if_lidded(slot, "drives its tips into a lid")
        return slots
