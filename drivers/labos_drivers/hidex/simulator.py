"""A simulated Hidex Sense."""

from __future__ import annotations

from typing import Any
from zlib import crc32

from labos.node import Setup
from labos_drivers._simulation import Gated

GRIDS = {"384": (16, 24), "": (8, 12)}
"""Rows and columns, by what a plate's type has in its name."""


class HidexSimulator(Gated):
    """Reads what is on its carrier."""

    gate_s = 10.0

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.reads = 0

    async def run_assay(self, assay: str) -> str:
        with self.motion():
            self.needs_closed()
            self.needs_bare(self.place("default"), "reads through a lid")
            await self.take_time(300)
            self.world.work(self.name, "read", self.place("default"), assay=assay)
            self.reads += 1
            return f"{assay}_{self.reads:04}.csv"

    async def read_plate(self, assay: str) -> dict[str, Any]:
        """What the plate holds is its own: the same plate reads the same twice, but for noise."""
        with self.motion():
            self.needs_closed()
            self.needs_bare(self.place("default"), "reads through a lid")
            await self.take_time(300)
            plate = self.world.work(self.name, "read", self.place("default"), assay=assay)
            kind = self.world.kind(plate)
            rows, columns = next(grid for mark, grid in GRIDS.items() if mark in kind)
            wells = [f"{chr(65 + row)}{column + 1}" for row in range(rows) for column in range(columns)]
            self.reads += 1
            return {
                "file": f"{assay}_{self.reads:04}.csv",
                "quantity": "absorbance",
                "unit": "OD",
                "wells": {well: self._absorbance(plate, well) for well in wells},
            }

    def _absorbance(self, plate: str, well: str) -> float:
        return round(crc32(f"{plate}/{well}".encode()) % 2000 / 1000 + self._random.gauss(0.05, 0.005), 4)
