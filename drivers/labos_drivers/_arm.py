"""A simulated arm that carries plates, and the names of stations in the effects of its actions."""

from __future__ import annotations

from typing import Any

from labos.core.ids import StationName
from labos.node import DeviceError
from labos.node.world import MISHAPS, lid_of
from labos_drivers._simulation import Simulated

SOURCE = StationName("{source}")
TARGET = StationName("{target}")
GRIPPER = StationName("gripper")


class Arm(Simulated):
    """A simulated arm with a hand that carries plates between taught places."""

    transfer_s = 30.0

    async def transfer(
        self,
        source: str,
        target: str,
        regrip: str = "",
        grips: tuple[str, str] = ("", ""),
        factor: float = 1.0,
    ) -> None:
        """Carry a plate. If a place ``regrip`` is named, the hand sets the plate down there and takes it
        again. The transfer takes ``factor`` times the usual duration. ``grips`` are those at the source
        and at the target."""
        usual_s = factor * self.transfer_s
        with self.motion():
            slip = self.draw_mishap()
            self.world.enter(self.name, self.place(source))
            await self.take_time(0.4 * usual_s)
            self._grip(source, grips[0], slip)
            await self.take_time(0.3 * usual_s)
            if regrip:
                self.world.enter(self.name, self.place(regrip))
                if self.find_held_plate():
                    self.world.release(self.name, self.place(regrip), grips[0])
                    # The bench takes the turn of the plate into account at the target.
                    self.world.grip(self.name, self.place(regrip), grips[0])
            self.world.enter(self.name, self.place(target))
            self._release_plate(target, grips[1], slip)
            await self.take_time(0.3 * usual_s)

    async def pick(self, source: str) -> None:
        """Take a plate and keep it in the hand."""
        with self.motion():
            slip = self.draw_mishap()
            self.world.enter(self.name, self.place(source))
            await self.take_time(0.4 * self.transfer_s)
            self._grip(source, "", slip)
            await self.take_time(0.2 * self.transfer_s)

    async def put_down(self, target: str) -> None:
        """Put down the plate in the hand. Raises DeviceError if there is none."""
        with self.motion():
            if not self.find_held_plate():
                raise DeviceError(f"The hand of {self.name} is empty.", effects="none")
            slip = self.draw_mishap()
            self.world.enter(self.name, self.place(target))
            await self.take_time(0.3 * self.transfer_s)
            self._release_plate(target, slip=slip)
            await self.take_time(0.3 * self.transfer_s)

    async def remove_lid(self, plate_at: str, nest: str, regrip: str = "") -> None:
        """Take the lid off the plate at a place, and put it into a nest."""
        await self.transfer(self._find_lid(plate_at, "unlid"), nest, regrip)

    async def replace_lid(self, nest: str, plate_at: str, regrip: str = "") -> None:
        """Put the lid from a nest onto the plate at a place."""
        await self.transfer(nest, self._find_lid(plate_at, "lid"), regrip)

    def observe(self) -> dict[str, Any]:
        return {"labware": {"gripper": bool(self.find_held_plate())}}

    def draw_mishap(self) -> str:
        """The unnoticed fault of the next motion; empty if there is none. The bench has set it, or it is
        drawn from ``MISHAPS`` because the hand is ``clumsy``. This setting is the share of motions that go
        wrong."""
        often = float(self.config.get("clumsy", 0.0))
        if often and self._random.random() < often:
            return self._random.choice(MISHAPS)
        return self.world.mishap(self.name)

    def _grip(self, source: str, how: str, slip: str) -> None:
        if slip == "misses":
            return
        self.world.grip(self.name, self.place(source), how)
        if slip == "drops":
            self.world.drop(self.name)

    def _release_plate(self, target: str, how: str = "", slip: str = "") -> None:
        if slip == "drops":
            self.world.drop(self.name)
        if slip:
            return  # the hand is empty, or keeps the plate and does not notice it
        self.open_hand(self.place(target), how)

    def _find_lid(self, place: str, verb: str) -> str:
        here = self.place(place)
        plate = self.top(here)
        if not plate:
            self.world.crash(self.name, here, f"would {verb} a plate that is not there")
        if self.world.is_shut(here):
            self.world.crash(self.name, here, "reaches into a closed gate")
        return lid_of(plate)
