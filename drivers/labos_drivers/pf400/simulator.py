"""A simulated PF400 on the bench, without a wire."""

from __future__ import annotations

from typing import Any

from labos.node import DeviceError, Setup
from labos_drivers._arm import Arm
from labos_drivers.pf400.protocol import NARROW, NEUTRAL

CRAWL = 8.0
"""So many times longer takes a slow move."""


class PF400Simulator(Arm):
    """An arm that changes its grip at the regrip place, if there is one. It has no joints. So it ignores
    poses, and the types of labware for which they were taught."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.regrip_at = setup.regrip
        self.is_free = self._was_freed = False
        for motion in self.world.motions():
            if motion.device == self.name and motion.verb in ("yield", "hold"):
                self.is_free = motion.verb == "yield"

    async def carry(
        self,
        source: str,
        target: str,
        source_grip: str,
        target_grip: str,
        kind: str = "",
        *,
        slow: bool = False,
        through: tuple[str, str] = ("", ""),
        turn_at: str = "",
    ) -> None:
        turn = self._regrip(source_grip, target_grip, turn_at)
        factor = CRAWL if slow else 1.0
        await self.transfer(source, target, turn, (source_grip, target_grip), factor)

    async def transfer(
        self,
        source: str,
        target: str,
        regrip: str = "",
        grips: tuple[str, str] = ("", ""),
        factor: float = 1.0,
    ) -> None:
        self._refuse_in_free_mode()
        await super().transfer(source, target, regrip, grips, factor)

    async def pick(self, source: str, grip: str = "", kind: str = "", through: str = "") -> None:
        self._refuse_in_free_mode()
        await super().pick(source)

    async def put_down(self, target: str, kind: str = "", through: str = "") -> None:
        self._refuse_in_free_mode()
        await super().put_down(target)

    async def open_fingers(self, wide: bool) -> None:
        with self.motion():
            if self.find_held_plate():
                raise self.make_refusal("its hand is full")
            await self.take_time(1)

    async def unlid(
        self, source: str, target: str, source_grip: str, target_grip: str, kind: str = "", plate: str = ""
    ) -> None:
        await self.remove_lid(source, target, self._regrip(source_grip, target_grip))

    async def relid(
        self, source: str, target: str, source_grip: str, target_grip: str, kind: str = "", plate: str = ""
    ) -> None:
        await self.replace_lid(source, target, self._regrip(source_grip, target_grip))

    def _regrip(self, source_grip: str, target_grip: str, turn_at: str = "") -> str:
        turns = "" not in (source_grip, target_grip) and source_grip != target_grip
        return (turn_at or self.regrip_at) if turns else ""

    async def explore(self) -> None:
        self._refuse_in_free_mode()
        with self.motion():
            if self.find_held_plate():
                raise DeviceError(
                    f"{self.name} holds a plate.", effects="none", remedy="Put it down before exploring."
                )
            await self.take_time(60)

    async def free(self, column: bool) -> None:
        """Begin free mode: a person may now move the arm by hand."""
        with self.motion():
            if self.find_held_plate():
                raise self.make_refusal("its hand is full")
            await self.take_time(2)
            self._become(free=True)

    async def hold(self) -> None:
        with self.motion():
            await self.take_time(1)
            self._become(free=False)
            await self.take_time(19)

    def read_pose(self) -> list[float]:
        """The pose of a folded arm with open fingers: this simulated arm is never moved by hand."""
        return [*NEUTRAL, NARROW.open_mm, 0.0]

    def reset(self) -> None:
        super().reset()
        self._become(free=False)
        self._was_freed = False

    def observe(self) -> dict[str, Any]:
        """``free`` is reported in free mode and, as by the driver, after ``hold`` until a reset."""
        seen = {"free": self.is_free} if self.is_free or self._was_freed else {}
        return {**super().observe(), **seen}

    def _become(self, *, free: bool) -> None:
        if free is not self.is_free:
            self.world.work(self.name, "yield" if free else "hold")
        self.is_free, self._was_freed = free, True

    def _refuse_in_free_mode(self) -> None:
        if self.is_free:
            self.world.crash(self.name, self.name, "moves while a person guides it")
