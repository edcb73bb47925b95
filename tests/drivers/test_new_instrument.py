"""A new instrument with two actions fits in thirty lines."""

from __future__ import annotations

import asyncio
import inspect
from typing import Annotated

from labos.node import Needs, Param, Requires, Sets, Station, World, action
from labos_drivers._simulation import Instrument, Simulated
from tests.drivers.conftest import Bench


class StirrerSimulator(Simulated):
    async def turn(self, speed_rpm: float) -> None:
        with self.motion():
            await self.take_time(5)
            self.world.work(self.name, "stir", self.place("default"), speed_rpm=speed_rpm)


class Stirrer(Instrument):
    """Magnetic stirrer."""

    driver = "stirrer"
    models = ("stirrer",)
    stations = (Station("default"),)
    variables = {"stirring": False}
    device: StirrerSimulator

    async def connect(self) -> None:
        self.device = StirrerSimulator(self.setup)

    @action(Needs(), Sets("module", "stirring", True), duration_s=5)
    async def start(self, speed: Annotated[float, Param(unit="rpm", minimum=50, maximum=1500)] = 300) -> None:
        """Stir the plate."""
        await self.device.turn(speed)

    @action(Requires("module", "stirring", True), Sets("module", "stirring", False), duration_s=5)
    async def stop_stirring(self) -> None:
        """Come to a halt."""
        await self.device.turn(0)


def test_a_new_instrument_is_small_and_works(bench: Bench, world: World) -> None:
    written = inspect.getsource(StirrerSimulator) + inspect.getsource(Stirrer)
    assert len([line for line in written.splitlines() if line.strip()]) <= 30

    async def body() -> None:
        stirrer = await bench.start(Stirrer, "stirrer")
        world.stock("stirrer.default", "plate")
        await stirrer.start(speed=500)
        await stirrer.stop_stirring()
        assert [motion.facts["speed_rpm"] for motion in world.motions("stir")] == [500, 0]

    asyncio.run(body())
    assert [spec.name for spec in Stirrer.describe().actions] == ["start", "stop_stirring", "reset"]
