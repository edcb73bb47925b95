"""The node of the SciClops, with its actions."""

from __future__ import annotations

from typing import Annotated

from labos.core.ids import StationName
from labos.node import Move, Param, Place, Relid, Station, Take, Unlid, action
from labos_drivers._arm import GRIPPER, SOURCE, TARGET
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.sciclops.driver import SciclopsDriver
from labos_drivers.sciclops.simulator import SciclopsSimulator
from labos_drivers.sciclops.wire import SciclopsOnWire


class Sciclops(OnBenchOrWire):
    """Plate stacker with five towers and an arm of its own."""

    driver = "sciclops"
    models = ("sciclops",)
    manipulator = True
    stations = (
        *(Station(f"tower{n}", kind="stack", capacity=20, claim=False) for n in range(1, 6)),
        Station("exchange", kind="exchange", claim=False),
        Station("lidnest1", claim=False),
        Station("lidnest2", claim=False),
        Station("gripper", kind="gripper"),
    )
    devices = (SciclopsSimulator, SciclopsOnWire, SciclopsDriver)
    device: SciclopsSimulator | SciclopsDriver

    @action(duration_s=30, safe_to_repeat=True)
    async def home(self) -> None:
        """Home all axes; the arm sweeps a large volume."""
        await self.device.home()

    @action(Take(StationName("{loc}"), TARGET), duration_s=40)
    async def get_plate(
        self,
        loc: Annotated[
            str, Param(place=True, aliases=("pos", "source"), description="the tower to take from")
        ],
        target: Annotated[str, Param(place=True, description="where the plate is put")] = "exchange",
    ) -> None:
        """Take the topmost plate of a tower and put it on the exchange."""
        await self.device.get_plate(loc, target)

    @action(Move(SOURCE, TARGET), duration_s=40)
    async def transfer(self, source: Place, target: Place) -> None:
        """Carry a plate between stations of the stacker."""
        await self.device.transfer(source, target)

    @action(Unlid(SOURCE, TARGET), duration_s=40)
    async def remove_lid(self, source: Place = "exchange", target: Place = "lidnest1") -> None:
        """Take the lid off the plate at ``source`` and put it into the nest ``target``."""
        await self.device.remove_lid(source, target)

    @action(Relid(SOURCE, TARGET), duration_s=40)
    async def replace_lid(self, source: Place = "lidnest1", target: Place = "exchange") -> None:
        """Put the lid from the nest ``source`` onto the plate at ``target``."""
        await self.device.replace_lid(source, target)

    @action(Move(GRIPPER, TARGET), duration_s=24)
    async def put_down(self, target: Place = "exchange") -> None:
        """Put down the plate that an interrupted transfer left in the hand."""
        await self.device.put_down(target)
