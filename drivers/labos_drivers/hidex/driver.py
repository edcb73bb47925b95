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
        file = self.result_of("run_assay", await self.call("run_assay", assay=assay))
        return str(file)

    async def read_plate(self, assay: str) -> dict[str, Any]:
        self._check(assay)
        table: dict[str, Any] = self.result_of("read_plate", await self.call("read_plate", assay=assay))
        return table

    def result_of(self, action: str, told: Any) -> Any:
        """What an action resulted in. Raises Garbled for what is no result of it: an assay that fails may end
        as others do, but leaves no file."""
        if action == "run_assay" and not (isinstance(told, str) and told):
            raise Garbled(
                f"{self.name}: the assay has ended without a file: {str(told)[:80]!r}.",
                remedy="Look at the reader's own software for what became of it, then reset the module.",
            )
        if action == "read_plate" and not (isinstance(told, dict) and isinstance(told.get("wells"), dict)):
            raise Garbled(f"{self.name}: {str(told)[:80]!r} is no table of wells.", effects="all")
        if action == "read_plate":  # what was too dark for the reader has no value
            told.setdefault("overflow", [well for well, value in told["wells"].items() if value is None])
        return told

    def _check(self, assay: str) -> None:
        """Raise DeviceError for what cannot be the name of a template."""
        if not assay or len(assay) > LONGEST_NAME or not assay.isprintable():
            raise DeviceError(
                f"{self.name}: {assay[:40]!r} is no name of an assay.",
                effects="none",
                remedy="Name a template as the reader's own software has it.",
            )
