"""Drives a Hidex Sense through a gateway to its maker's service."""

from __future__ import annotations

from typing import Any

from labos.errors import DeviceError, Garbled
from labos_drivers.gateway.driver import GatewayDriver

LONGEST_NAME = 100


class HidexDriver(GatewayDriver):
    """``open`` and ``close`` are of the plate carrier. An assay ends when its file is whole."""

    instrument = "hidex"

    async def open_gate(self) -> None:
        await self.call("open")

    async def close_gate(self) -> None:
        await self.call("close")

    async def run_assay(self, assay: str) -> str:
        self._check(assay)
        return str(await self.call("run_assay", assay=assay))

    async def read_plate(self, assay: str) -> dict[str, Any]:
        self._check(assay)
        table = await self.call("read_plate", assay=assay)
        if not isinstance(table, dict) or not isinstance(table.get("wells"), dict):
            raise Garbled(f"{self.name}: {str(table)[:80]!r} is no table of wells.", effects="all")
        return table

    def _check(self, assay: str) -> None:
        """Raise DeviceError for what cannot be the name of a template."""
        if not assay or len(assay) > LONGEST_NAME or not assay.isprintable():
            raise DeviceError(
                f"{self.name}: {assay[:40]!r} is no name of an assay.",
                effects="none",
                remedy="Name a template as the reader's own software has it.",
            )
