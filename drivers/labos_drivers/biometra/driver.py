"""The driver of a TRobot, which it controls through a gateway to the library of its maker."""

from __future__ import annotations

from labos_drivers.gateway.driver import GatedDriver

LARGEST_PROGRAM = 999
"""A bound of our own: how many programs a cycler stores is not published. What it has not stored its gateway
refuses."""


class BiometraDriver(GatedDriver):
    """``open_lid`` and ``close_lid`` end when the lid stands still, ``run_program`` ends with the program."""

    instrument = "biometra"

    async def run_program(self, number: int) -> None:
        if number > LARGEST_PROGRAM:
            raise self.make_refusal(f"there is no program {number}")
        await self.call("run_program", number=number)
