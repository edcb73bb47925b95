"""The actions of the pipette."""

from __future__ import annotations

from typing import Annotated

from labos.node import Param, Sets, action
from labos_drivers._simulation import await_answer
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.pipette.driver import PipetteDriver
from labos_drivers.pipette.simulator import PipetteSimulator
from labos_drivers.pipette.wire import PipetteOnWire

Volume = Annotated[float, Param(unit="µL", minimum=0.2, maximum=1000, aliases=("vol", "amount"))]
Speed = Annotated[float, Param(unit="µL/s", minimum=1, maximum=500)]

DRAWN_UP, EMPTY = Sets("module", "drawn_up", "{result}"), Sets("module", "drawn_up", 0.0)
"""In µL, by where the plunger stands."""


class Pipette(OnBenchOrWire):
    """Electronic pipette with one channel, carried by an arm."""

    driver = "pipette"
    models = ("pipette", "tricontinent", "tricontinent_z_pump", "air_z")
    variables = {"drawn_up": 0.0}
    follows = ("aspirate", "dispense")
    devices = (PipetteSimulator, PipetteOnWire, PipetteDriver)
    device: PipetteSimulator | PipetteDriver

    @action(EMPTY, duration_s=10, aliases=("initialize",))
    async def initialise(self) -> None:
        """Bring the plunger to its end: whatever is drawn up comes out."""
        await self.device.initialise()

    @action(DRAWN_UP, duration_s=5)
    async def aspirate(self, volume: Volume, speed: Speed = 20.0) -> float:
        """Draw up; the result is what is drawn up then, in µL."""
        return await self.device.aspirate(volume, speed)

    @action(DRAWN_UP, duration_s=5)
    async def dispense(self, volume: Volume, speed: Speed = 20.0) -> float:
        """Let out; the result is what is still drawn up then, in µL."""
        return await self.device.dispense(volume, speed)

    @action(EMPTY, duration_s=5)
    async def eject_tip(self) -> None:
        """Throw the tip off, where the pump can; a Z pump leaves that to the arm."""
        await self.device.eject_tip()

    @action(duration_s=1, safe_to_repeat=True, exclusive=False)
    async def get_volume(self) -> float:
        """What is drawn up, in µL, by where the plunger stands."""
        return await await_answer(self.device.read_volume())

    @action(EMPTY, duration_s=10, recovers=True)
    async def reset(self) -> None:
        """Initialise it; whatever is drawn up comes out."""
        await super().reset()
