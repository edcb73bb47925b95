"""People who reach into a workcell in whole labs: no device moves while their hands are inside."""

from __future__ import annotations

import asyncio

import pytest

from labos.core import rules
from labos.core.decide import access
from labos.core.decide.access import EndAccess, RequestAccess
from labos.core.model import PlanStep
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.errors import LabosError
from labos.node.world import World
from labos.testing.faults import QUIET, FaultRates
from labos.testing.lab import LOOK_S, SimulatedLab
from labos.testing.loop import Killed
from tests.simulation.mixes import CELL, identical, stand
from tests.support.seeds import quiet_and_stormy

CELL_NAME = CELL.workcell.name
VISITS = 4


class Hands(SimulatedLab):
    """Somebody comes now and then, and the bench remembers when hands were inside."""

    granted = 0

    async def _act_as_person(self) -> None:
        self._people.append(self.loop.create_task(self._visitor()))
        await super()._act_as_person()

    async def _visitor(self) -> None:
        for _ in range(VISITS):
            await asyncio.sleep(self.rng.uniform(100, 600))
            if await self._try(RequestAccess(CELL_NAME, "visitor"), lambda access: access is not None):
                await self._try(None, lambda access: access is None or access.granted)
                self.world.work("visitor", "reach in")
                self.granted += 1
                await asyncio.sleep(self.rng.uniform(50, 300))
                self.world.work("visitor", "reach out")
                await self._try(EndAccess(CELL_NAME, "visitor"), lambda access: access is None)

    async def _try(self, command, holds) -> bool:  # type: ignore[no-untyped-def]
        """Say it until it is so in the log."""
        while True:
            try:
                kernel = self.kernel
                if kernel is not None:
                    await self._ask(kernel, kernel.flush())
                    if holds(kernel.state.lab.access.get(CELL_NAME)):
                        return True
                    if command is not None:
                        await self._ask(kernel, kernel.execute(command, "visitor"))
                        continue
            except (LabosError, TimeoutError, Killed):
                pass
            await asyncio.sleep(LOOK_S)


def list_motions_inside(world: World) -> list[str]:
    """What devices did while hands were inside."""
    inside, found = False, []
    for motion in world.motions():
        if motion.verb in ("reach in", "reach out"):
            inside = motion.verb == "reach in"
        elif inside and motion.device not in ("person", "visitor", "bench"):
            found.append(f"{motion.device} {motion.verb} {motion.place}")
    return found


def run_visit(seed: int, rates: FaultRates) -> tuple[int, list[str]]:
    lab = Hands(stand(), seed, rates)
    try:
        state = lab.run(identical(3))
        assert lab.differences(state) == [], f"seed {seed}"
        return lab.granted, list_motions_inside(lab.world)
    finally:
        lab.close()


@pytest.mark.slow
@quiet_and_stormy
def test_nothing_moves_while_hands_are_inside(rates: FaultRates) -> None:
    granted = 0
    for seed in range(3):
        visits, touched = run_visit(seed, rates)
        assert touched == [], f"seed {seed}"
        granted += visits
    assert granted > 3


@pytest.mark.slow
def test_without_the_rule_hands_are_hurt(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rule forgets those who are inside."""
    rule = rules.check_no_access

    def forgetful(state: LabState, run: RunState, step: PlanStep) -> Wait | None:
        access = state.lab.access.get(CELL_NAME)
        return rule(state, run, step) if access is not None and not access.granted else None

    monkeypatch.setattr(rules, "check_no_access", forgetful)
    assert any(run_visit(seed, QUIET)[1] for seed in range(3))


@pytest.mark.slow
def test_without_waiting_for_what_is_in_flight_hands_are_hurt(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(access, "list_in_motion", lambda *_: [])
    assert any(run_visit(seed, QUIET)[1] for seed in range(3))
