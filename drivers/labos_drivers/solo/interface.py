"""The node of the SOLO, with its actions."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Annotated, ClassVar

from labos.core.counts import Counter
from labos.node import Consumes, Needs, Param, Requires, Station, action
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.solo import protocol
from labos_drivers.solo.driver import SoloDriver
from labos_drivers.solo.protocol import count_used_tips
from labos_drivers.solo.simulator import POSITIONS, SoloSimulator
from labos_drivers.solo.wire import SoloOnWire


class Solo(OnBenchOrWire):
    """Liquid handler with eight deck positions."""

    driver = "solo"
    models = ("solo", "hudson_solo")
    stations = tuple(Station(position, kind="deck") for position in POSITIONS)
    levels = {"tips": 384}
    counters: ClassVar[dict[str, Counter]] = {"tips": count_used_tips}
    follows = ("run_protocol",)
    devices = (SoloSimulator, SoloOnWire, SoloDriver)
    device: SoloSimulator | SoloDriver

    # Tips: the number in the protocol's steps; if it is not certain, at least one column (8).
    @action(
        Needs(),
        Requires("labware", "sealed", False),
        Requires("labware", "lidded", False),
        Consumes("tips", "{file:protocol_path:tips|8}"),
        duration_s=300,
    )
    async def run_protocol(
        self,
        protocol_path: Annotated[
            str,
            Param(file=True, aliases=("config_path", "hso_path"), description="the .hso protocol to run"),
        ],
    ) -> None:
        """Run a protocol of 69 steps at most on what stands on the deck."""
        # The driver checks a protocol before it sends it. The simulated device does not, so it is done here.
        if isinstance(self.device, SoloSimulator) and (file := Path(protocol_path)).is_file():
            await asyncio.to_thread(protocol.read_protocol, self.setup.name, file)
        await self.device.run_protocol(protocol_path)
