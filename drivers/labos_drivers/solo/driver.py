"""Drives a SOLO through a gateway to SOLOSoft, its maker's program."""

from __future__ import annotations

import functools
from pathlib import Path

from labos_drivers.gateway.driver import GatewayDriver
from labos_drivers.solo import protocol


class SoloDriver(GatewayDriver):
    """Sends the whole text of a protocol to the gateway. The gateway's hands report the end when the program
    was busy and is idle again."""

    instrument = "solo"

    async def run_protocol(self, path: str) -> None:
        file = Path(path)
        text = await self.run(functools.partial(protocol.read_protocol, self.name, file))
        await self.call("run_protocol", name=file.name, text=text)
