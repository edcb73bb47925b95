"""The simulated beamline as a process: an IOC in its own environment, which looks at a lab's bench."""

from __future__ import annotations

from pathlib import Path

from labos.spec.library import find_specs_folder
from tests.support.ioc import Ioc


class Beamline(Ioc):
    """``faults`` is what goes wrong with the first series: ``dark``, ``bright``, or ``""`` for nothing."""

    def __init__(self, folder: Path, world: Path, *faults: str, seed: int = 0) -> None:
        super().__init__(folder)
        self._world, self._faults, self._seed = world, faults, seed

    def command(self) -> list[Path | str]:
        return [self.python, find_specs_folder() / "apps" / "pendant_drop" / "beamline_ioc.py"]

    def environment(self) -> dict[str, str]:
        told = {"WORLD": str(self._world), "FAULTS": ",".join(self._faults), "SEED": str(self._seed)}
        return {**super().environment(), **told}
