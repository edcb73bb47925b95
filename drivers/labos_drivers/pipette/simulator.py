"""A simulated pipette."""

from __future__ import annotations

from typing import Any

from labos.node import Setup
from labos_drivers._simulation import Simulated
from labos_drivers.pipette import protocol

STARTS_S, EJECTS_S = 10.0, 5.0


class PipetteSimulator(Simulated):
    """The plunger of a pipette. The liquid that it draws up is not simulated."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._kind = protocol.KINDS[setup.config.get("kind", "z_pump")]
        self._ul = 0.0

    async def initialise(self) -> None:
        with self.motion():
            await self.take_time(STARTS_S)
            self.world.work(self.name, "initialise", ul=self._ul)
            self._ul = 0.0

    async def aspirate(self, volume_ul: float, speed_ul_s: float) -> float:
        return await self._move("aspirate", volume_ul, speed_ul_s)

    async def dispense(self, volume_ul: float, speed_ul_s: float) -> float:
        return await self._move("dispense", -volume_ul, speed_ul_s)

    async def _move(self, verb: str, change_ul: float, speed_ul_s: float) -> float:
        if not 0 <= self._ul + change_ul <= self._kind.volume_ul:
            raise self.make_refusal(
                f"{self._ul:g} of {self._kind.volume_ul:g} µL are drawn up; "
                f"{abs(change_ul):g} µL cannot be {verb}d",
                "Ask for less, or empty it first.",
            )
        with self.motion():
            await self.take_time(abs(change_ul) / speed_ul_s)
            self._ul += change_ul
            self.world.work(self.name, verb, ul=abs(change_ul))
        return round(self._ul, 2)

    async def eject_tip(self) -> None:
        if not self._kind.eject:
            raise self.make_refusal(
                "this pump has no ejector", "Let the arm strip the tip off: run its program for that."
            )
        with self.motion():
            await self.take_time(EJECTS_S)
            self.world.work(self.name, "eject")
            self._ul = 0.0

    def read_volume(self) -> float:
        return round(self._ul, 2)

    def observe(self) -> dict[str, Any]:
        """Always empty: there is no sensor for a tip or for liquid."""
        return {}
