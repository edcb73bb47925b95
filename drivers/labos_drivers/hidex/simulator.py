"""A simulated Hidex Sense."""

from __future__ import annotations

import re
from typing import Any
from zlib import crc32

from labos.node import Setup
from labos_drivers._optics import absorbance_of
from labos_drivers._simulation import Gated

GRIDS = {"384": (16, 24), "": (8, 12)}
"""Rows and columns, by what a plate's type has in its name."""

USUAL_NM = 600.0


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
                "wells": self._absorbances(plate, wells, assay),
            }

    def _absorbances(self, plate: str, wells: list[str], assay: str) -> dict[str, float]:
        """Of what was pipetted into it, at the wavelength in the assay's name (nm). A plate into which
        nothing was holds something of its own."""
        contents = self.world.contents(plate)
        told = re.search(r"[2-9][0-9]{2}", assay)
        nm = float(told[0]) if told else USUAL_NM
        found = {}
        for well in wells:
            own = 0.05 + crc32(f"{plate}/{well}".encode()) % 2000 / 1000
            level = absorbance_of(contents.get(well, {}), nm) if contents else own
            found[well] = round(level + self._random.gauss(0.0, 0.005), 4)
        return found
