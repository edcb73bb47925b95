"""A simulated Hidex Sense on the bench, without a wire."""

from __future__ import annotations

import re
from typing import Any
from zlib import crc32

from labos.node import Setup
from labos_drivers._growth import Stay, compute_growth
from labos_drivers._optics import absorbance_of
from labos_drivers._simulation import Gated

GRIDS = {"384": (16, 24), "": (8, 12)}
"""Rows and columns, by what a plate's type has in its name."""

USUAL_NM = 600.0

HIGHEST_OD = 4.0
"""What absorbs more has no value: the reader overflows."""


class HidexSimulator(Gated):
    """A reader that measures the plate on its carrier."""

    gate_s = 10.0

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.reads = 0

    async def run_assay(self, assay: str) -> str:
        with self.motion():
            await self._read(assay)
            return self._name_file(assay)

    async def read_plate(self, assay: str) -> dict[str, Any]:
        """The table of absorbances. An unchanged plate gives the same values again, except for noise."""
        with self.motion():
            plate = await self._read(assay)
            kind = self.world.kind(plate)
            rows, columns = next(grid for mark, grid in GRIDS.items() if mark in kind)
            wells = [f"{chr(65 + row)}{column + 1}" for row in range(rows) for column in range(columns)]
            read = self._read_absorbances(plate, wells, assay)
            return {
                "file": self._name_file(assay),
                "quantity": "absorbance",
                "unit": "OD",
                "wells": read,
                "overflow": [well for well, level in read.items() if level is None],
            }

    async def _read(self, assay: str) -> str:
        """Read the plate, and return its name."""
        self.check_closed()
        self.crash_if_lidded(self.place("default"), "reads through a lid")
        await self.take_time(300)
        return self.world.work(self.name, "read", self.place("default"), assay=assay)

    def _name_file(self, assay: str) -> str:
        self.reads += 1
        return f"{assay}_{self.reads:04}.csv"

    def _read_absorbances(self, plate: str, wells: list[str], assay: str) -> dict[str, float | None]:
        """The absorbance (OD) of each well, for what was pipetted into it, at the wavelength in the assay's
        name (nm); None if it overflows. If nothing was pipetted into a plate, its wells have fixed values."""
        contents = self.world.contents(plate)
        named = re.search(r"[2-9][0-9]{2}", assay)
        nm = float(named[0]) if named else USUAL_NM
        found: dict[str, float | None] = {}
        stays = self._list_stays(plate) if contents else []
        for well in wells:
            own = 0.05 + crc32(f"{plate}/{well}".encode()) % 2000 / 1000
            held = contents.get(well, {})
            level = absorbance_of(held, nm) + compute_growth(held, stays) if contents else own
            shown = round(level + self._random.gauss(0.0, 0.005), 4)
            found[well] = shown if shown <= HIGHEST_OD else None
        return found

    def _list_stays(self, plate: str) -> list[Stay]:
        """The ended incubations of the plate so far: duration (h) and temperature (°C)."""
        stays: list[Stay] = []
        since: tuple[float, float] | None = None
        for motion in self.world.history(plate, "incubate", "cool"):
            if motion.verb == "incubate":
                since = motion.facts["at_h"], motion.facts["celsius"]
            elif since is not None:
                stays.append((max(motion.facts["at_h"] - since[0], 0.0), since[1]))
                since = None
        return stays
