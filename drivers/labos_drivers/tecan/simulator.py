"""A simulated Infinite."""

from __future__ import annotations

from typing import Any
from zlib import crc32

from labos_drivers._optics import absorbance_of
from labos_drivers._simulation import Gated


def absorbance(
    plate: str, well: str, nm: float, contents: dict[str, dict[str, float]] | None = None
) -> float:
    """Of what was pipetted into the plate's wells (``contents``). A plate into which nothing was holds
    something of its own: a band about some wavelength, the same each time."""
    if contents:
        return absorbance_of(contents.get(well, {}), nm)
    seed = crc32(f"{plate}/{well}".encode())
    middle, height = 350 + seed % 500, 0.1 + seed // 500 % 1500 / 1000
    return 0.04 + height / (1 + ((nm - middle) / 60) ** 2)


class TecanSimulator(Gated):
    """Reads what is on its carrier."""

    variable = "gate"
    gate_s = 10.0

    async def measure(
        self, method: str, start_nm: float, end_nm: float, step_nm: float, wells: int, name: str
    ) -> str:
        with self.motion():
            self.needs_closed()
            self.needs_bare(self.place("default"), "reads through a lid")
            await self.take_time(350)
            self.world.work(
                self.name, "read", self.place("default"), method=method, start_nm=start_nm, end_nm=end_nm
            )
            return name

    def reset(self) -> None:
        super().reset()
        self.open(*self.behind)

    def look(self) -> dict[str, Any]:
        """The plate is felt when the carrier is in."""
        seen = super().look()
        if self.is_closed():
            seen["labware"] = {"default": bool(self.top(self.place("default")))}
        return seen
