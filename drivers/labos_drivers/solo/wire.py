"""A simulated SOLO behind the reference gateway."""

from __future__ import annotations

from labos.node import Setup
from labos_drivers.gateway.wire import GatewayOnWire
from labos_drivers.solo.simulator import SoloSimulator


class SoloOfText(SoloSimulator):
    """A simulated SOLO that receives the text of a protocol, not its path."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.given = ""

    async def run_text(self, name: str, text: str) -> None:
        self.given = text
        await self.run_protocol(name)

    def read_text(self, protocol: str) -> str:
        return self.given


class SoloOnWire(GatewayOnWire[SoloOfText]):
    instrument = "solo"
    kind = SoloOfText
    actions = {"run_protocol": "run_text"}
