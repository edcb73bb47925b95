"""A simulated Infinite."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any
from zlib import crc32

from labos.node import Attachment, World
from labos_drivers import _polymers
from labos_drivers._optics import absorbance_of
from labos_drivers._simulation import Gated
from labos_drivers.tecan import protocol
from labos_drivers.tecan.protocol import GRIDS, MOST_OD, write_table


def absorbance(
    plate: str, well: str, nm: float, contents: dict[str, dict[str, float]] | None = None
) -> float:
    """The absorbance of a well at a wavelength (nm), by what was pipetted into the plate (``contents``). If
    nothing was, each well has an absorption band. It depends on plate and well, and is the same each time."""
    if contents:
        return absorbance_of(contents.get(well, {}), nm)
    seed = crc32(f"{plate}/{well}".encode())
    middle, height = 350 + seed % 500, 0.1 + seed // 500 % 1500 / 1000
    return 0.04 + height / (1 + ((nm - middle) / 60) ** 2)


def optics_of(world: World, plate: str) -> Callable[[str, float], float]:
    """A function for the optical density of a plate's wells at a wavelength (nm). It uses the polymers that
    were made in the plate, else what was pipetted into it."""
    polymers = _polymers.find_polymers(world, plate)
    contents = {} if polymers else world.contents(plate)
    nothing = _polymers.Polymer((0.0, 0.0, 0.0), 1.0)
    if polymers:
        return lambda well, nm: _polymers.absorbance_of(polymers.get(well, nothing), nm)
    return lambda well, nm: absorbance(plate, well, nm, contents)


class TecanSimulator(Gated):
    """Measures the plate on its carrier, with noise. The value of a well with a bubble is NaN."""

    variable = "gate"
    gate_s = 10.0

    async def measure(
        self, method: str, start_nm: float, end_nm: float, step_nm: float, wells: int, name: str
    ) -> Attachment:
        nms = protocol.list_wavelengths(start_nm, end_nm, step_nm)
        if not 0 < len(nms) <= protocol.MOST_WAVELENGTHS:
            raise self.make_refusal(f"{len(nms)} wavelengths cannot be measured")
        with self.motion():
            self.check_closed()
            self.crash_if_lidded(self.place("default"), "reads through a lid")
            await self.take_time(350)
            place = self.place("default")
            bubbles = _polymers.find_bubbles(self.world, self.top(place))
            plate = self.world.work(self.name, "read", place, method=method, start_nm=start_nm, end_nm=end_nm)
            return Attachment(name, self._table(plate, nms, wells, bubbles))

    def _table(self, plate: str, nms: list[float], wells: int, bubbles: set[str]) -> bytes:
        grid, see = GRIDS[wells], optics_of(self.world, plate)
        names = [grid.well(row, column) for row in range(grid.rows) for column in range(grid.columns)]
        add_noise, draw = _polymers.add_noise, self._random.gauss
        spectra = {
            nm: {
                well: math.nan if well in bubbles else add_noise(see(well, nm), draw, MOST_OD)
                for well in names
            }
            for nm in nms
        }
        return write_table(spectra, grid)

    def reset(self) -> None:
        super().reset()
        self.open(*self.behind)

    def observe(self) -> dict[str, Any]:
        """The gate, and whether a plate is there: its sensor sees it only while the carrier is in."""
        seen = super().observe()
        if self.is_closed():
            seen["labware"] = {"default": bool(self.top(self.place("default")))}
        return seen
