"""A wall clock that was hours fast is set right between a turn and its alarm: nobody waits for hours."""

from __future__ import annotations

import asyncio

import pytest

from labos.core.decide.control import PauseStarts, ResumeStarts
from labos.planning.scheduler import make_searching_scheduler
from labos.runtime.kernel import Kernel
from labos.testing.faults import QUIET
from labos.testing.lab import Job, SimulatedLab
from labos.testing.loop import VirtualClock
from tests.simulation.proof.labs import cell, route

FAST_S = 9 * 3600.0
ALL = "*"


class FastLab(SimulatedLab):
    """A lab that looks for an order of runs that were submitted together. Its clock is fast until somebody
    has waited for a time in so many ``turns``."""

    def __init__(self, turns: int) -> None:
        super().__init__(cell("sealing").stand, 0, QUIET, plan_with=make_searching_scheduler)
        self.turns = turns

    async def _serve(self, kernel: Kernel) -> None:
        clock = kernel.clock
        assert isinstance(clock, VirtualClock)

        def look(_: float) -> None:
            if self.turns and kernel.scheduler.wait_list.find_first() is not None:
                self.turns -= 1
                if not self.turns:
                    clock.set(0.0)

        clock.set(FAST_S)
        kernel.on_turn = look

    async def _set_up(self) -> None:
        await super()._set_up()
        await self._insist(PauseStarts(ALL, "ada"))
        self._people.append(self.loop.create_task(self._begin()))

    async def _begin(self) -> None:
        await asyncio.sleep(5.0)
        await self._insist(ResumeStarts(ALL, "ada"))


def find_end(turns: int) -> float:
    """When all work is done (virtual s)."""
    lab = FastLab(turns)
    try:
        lab.run([Job(f"j{n}", "ada", (route("sealing", n),), after_s=1.0) for n in range(3)])
        assert not lab.turns
        return lab.loop.time()
    finally:
        lab.close()


@pytest.mark.parametrize("turns", [1, 2, 20])
def test_nobody_waits_until_the_clock_has_caught_up(turns: int) -> None:
    assert find_end(turns) == pytest.approx(find_end(0), abs=60.0)
