"""The instruments of the applications without a lab: simulated devices on one bench in memory, and the
speckle of the simulated beamline."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np
from drop_dynamics import Series
from polymer_colours import Spectra, read_table
from polymer_recommender import Recipe

from labos.node import Setup, World
from labos_drivers.chemspeed import Chemspeed
from labos_drivers.tecan import Tecan
from tests.drivers.conftest import lab_seconds


class Platform:
    """A synthesis platform, a reader, and a plate that somebody carries between them."""

    def __init__(self, seed: int = 0, **config: Any) -> None:
        self.world = World()
        self.seed, self.config = seed, config
        (self.plate,) = self.world.stock("chemspeed.default", "plate96")

    def make(self, wells: Sequence[str], recipes: Sequence[Recipe], monomers_ul: float = 60.0) -> None:
        async def work() -> None:
            platform = Chemspeed(self._setup("chemspeed"))
            await platform.connect()
            await platform.close_lid()
            doses = [[recipe[part] * monomers_ul for recipe in recipes] for part in range(3)]
            lengths = [recipe.length for recipe in recipes]
            await platform.run_program("closed_loop1", list(wells), *doses, lengths)
            await platform.open_lid()

        lab_seconds(work)

    def table(self, step: float = 10.0) -> bytes:
        """What the reader exports of the plate."""

        async def work() -> bytes:
            reader = Tecan(self._setup("tecan"))
            await reader.connect()
            self.world.carry(self.plate, "tecan.default")
            await reader.close_gate()
            attached = await reader.measure_sample(step=step)
            await reader.open_gate()
            self.world.carry(self.plate, "chemspeed.default")
            assert isinstance(attached.content, bytes)
            return attached.content

        return lab_seconds(work)

    def measure(self, step: float = 10.0) -> Spectra:
        return read_table(self.table(step))

    def _setup(self, name: str) -> Setup:
        at = self.world.last_motion()  # each reading has other noise
        return Setup(
            name=name, workcell="cnm", world=self.world, seed=self.seed * 1000 + at, config=self.config
        )


def _load_beamline() -> ModuleType:
    """The module of the IOC, without the library by which it is one."""
    library = ModuleType("softioc")
    for name in ("asyncio_dispatcher", "builder", "softioc"):
        setattr(library, name, ModuleType(name))
    before = sys.modules.get("softioc")
    sys.modules["softioc"] = library
    try:
        import beamline_ioc
    finally:
        del sys.modules["softioc"]
        if before is not None:
            sys.modules["softioc"] = before
    return beamline_ioc


beamline: Any = _load_beamline()


def series(
    liquid: str,
    particle: str,
    *,
    frames: int = 256,
    period: float = 2e-5,
    photons: float = 40.0,
    seed: int = 0,
) -> Series:
    """What the detector sees of spheres in a liquid."""
    q = beamline.q_of_pixels()
    rate = beamline.diffusion(liquid, particle) * q**2
    counts = beamline.speckle(rate, frames, period, photons, np.random.default_rng(seed))
    return Series(counts, period, q, beamline.TEMPERATURE_K)
