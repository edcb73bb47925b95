"""A simulated PF400."""

from __future__ import annotations

from labos.node import DeviceError, Setup
from labos_drivers._arm import Arm

CRAWL = 8.0
"""So many times longer takes a slow move."""


class PF400Simulator(Arm):
    """An arm that turns its grip at a regrip place, if it was taught one. It has no joints, so that poses,
    and the types of labware that they are for, make no difference."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.regrip_at = setup.regrip

    async def carry(
        self,
        source: str,
        target: str,
        source_grip: str,
        target_grip: str,
        kind: str = "",
        *,
        slow: bool = False,
    ) -> None:
        turn = self._regrip(source_grip, target_grip)
        factor = CRAWL if slow else 1.0
        await self.transfer(source, target, turn, (source_grip, target_grip), factor)

    async def unlid(
        self, source: str, target: str, source_grip: str, target_grip: str, kind: str = "", plate: str = ""
    ) -> None:
        await self.remove_lid(source, target, self._regrip(source_grip, target_grip))

    async def relid(
        self, source: str, target: str, source_grip: str, target_grip: str, kind: str = "", plate: str = ""
    ) -> None:
        await self.replace_lid(source, target, self._regrip(source_grip, target_grip))

    def _regrip(self, source_grip: str, target_grip: str) -> str:
        turns = "" not in (source_grip, target_grip) and source_grip != target_grip
        return self.regrip_at if turns else ""

    async def put_down(self, target: str, kind: str = "") -> None:
        await super().put_down(target)

    async def explore(self) -> None:
        with self.motion():
            if self.held():
                raise DeviceError(
                    f"{self.name} holds a plate.", effects="none", remedy="Put it down before exploring."
                )
            await self.take_time(60)
