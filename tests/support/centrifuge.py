"""A simulated centrifuge with a truth of its own: which plates were in the rotor when it turned.

It knows nothing of runs: whatever stands on one of its four places is spun. Its lid is shut while it turns,
and it turns on when its node dies.
"""

from __future__ import annotations

from typing import Annotated

from labos.core.effects import Needs
from labos.core.model import Station
from labos.node import Param, Setup, action
from labos.node.world import World
from labos_drivers._simulation import Instrument, Simulated

PLACES = 4
TURN_S = 120.0


class CentrifugeSimulator(Simulated):
    """Shuts its lid, turns, opens it."""

    def __init__(self, setup: Setup) -> None:
        self.drawers = tuple(f"{setup.name}.rotor.{number}" for number in range(1, PLACES + 1))
        super().__init__(setup)

    async def spin(self, g: int) -> list[str]:
        """Returns the plates that were in it."""
        with self.motion(drawn_in=True):
            places = [self.place(name) for name in self.drawers]
            inside = [place for place in places if self.world.at(place)]
            if not inside:
                self.world.crash(self.name, self.name, "turns an empty rotor")
            plates = [self.world.work(self.name, "spin", place, g=g) for place in inside]
            self.world.work(self.name, "turn", plates=plates, g=g)
            await self.take_time(TURN_S)
            return plates


class Centrifuge(Instrument):
    """A centrifuge with four places and a lid of its own."""

    driver = "centrifuge"
    stations = (Station("rotor", kind="hotel", capacity=PLACES, access={"lid": "open"}),)
    variables = {"lid": "open"}
    rest = {"lid": "open"}
    device: CentrifugeSimulator

    async def connect(self) -> None:
        self.device = CentrifugeSimulator(self.setup)

    @action(Needs(), duration_s=TURN_S)
    async def spin(self, g: Annotated[int, Param(minimum=100, maximum=5000)] = 1000) -> list[str]:
        """Spin what is in the rotor."""
        return await self.device.spin(g)


def list_turns(world: World) -> list[list[str]]:
    """The plates that were in the rotor, for each time it turned."""
    return [motion.facts["plates"] for motion in world.motions("turn")]


def count_spins(world: World) -> dict[str, int]:
    """How often each plate was spun."""
    found: dict[str, int] = {}
    for plates in list_turns(world):
        for plate in plates:
            found[plate] = found.get(plate, 0) + 1
    return found
