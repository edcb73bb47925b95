"""Drives a TRobot through a gateway to its maker's library."""

from __future__ import annotations

from labos_drivers.gateway.driver import GatedDriver

LARGEST_PROGRAM = 999
"""A bound of our own: how many programs a cycler stores is not published. What it has not stored its gateway
refuses."""


class BiometraDriver(GatedDriver):
    """``open_lid``, ``close_lid`` and ``run_program`` end when the lid, or the program, has come to rest."""

    instrument = "biometra"

    async def run_program(self, number: int) -> None:
        if number > LARGEST_PROGRAM:
            raise self.make_refusal(f"there is no program {number}")
        await self.call("run_program", number=number)
