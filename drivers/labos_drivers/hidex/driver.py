"""The driver of a Hidex Sense, through a gateway to the service of its maker."""

from __future__ import annotations

from typing import Any

from labos.errors import Garbled
from labos_drivers.gateway.driver import GatedDriver

LONGEST_NAME = 100


class HidexDriver(GatedDriver):
    """``open`` and ``close`` move the plate carrier. An assay ends when its file is complete."""

    instrument = "hidex"
    gate = ("open", "close")

    async def run_assay(self, assay: str) -> str:
        self._check_assay(assay)
        file = self.parse_result("run_assay", await self.call("run_assay", assay=assay))
        return str(file)

    async def read_plate(self, assay: str) -> dict[str, Any]:
        self._check_assay(assay)
        table: dict[str, Any] = self.parse_result("read_plate", await self.call("read_plate", assay=assay))
        return table

    def parse_result(self, action: str, result: Any) -> Any:
        """The result of an action. Raises Garbled if it is invalid. An assay that fails may end like a
        successful one, but leaves no file."""
        if action == "run_assay" and not (isinstance(result, str) and result):
            raise Garbled(
                f"{self.name}: the assay has ended without a file: {str(result)[:80]!r}.",
                remedy="Look at the reader's own software for what became of it, then reset the module.",
            )
        if action == "read_plate" and not (
            isinstance(result, dict) and isinstance(result.get("wells"), dict)
        ):
            raise Garbled(f"{self.name}: {str(result)[:80]!r} is no table of wells.", effects="all")
        if action == "read_plate":  # a well that absorbs too much for the reader has no value
            result.setdefault("overflow", [well for well, value in result["wells"].items() if value is None])
        return result

    def _check_assay(self, assay: str) -> None:
        """Raise DeviceError if this cannot be the name of a template."""
        if not assay or len(assay) > LONGEST_NAME or not assay.isprintable():
            raise self.make_refusal(
                f"{assay[:40]!r} is no name of an assay",
                "Name a template as the reader's own software has it.",
            )
