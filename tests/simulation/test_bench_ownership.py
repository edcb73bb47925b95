"""Whose a plate is between two runs, and that what an experiment has parked can be cleared away. Each
of the rules is switched off once, and the bench shows it."""

from __future__ import annotations

import asyncio

import pytest

from labos.core.decide.experiments import StartExperiment
from labos.core.ids import SHARED, StationName
from labos.node import Needs, Node, Station, World, action
from labos.testing.faults import QUIET, STORMY, FaultRates
from labos.testing.lab import Job, SimulatedLab
from labos.testing.loop import Stalled
from tests.simulation.corners import Corner


class Scale(Node):
    """Remembers for whom it weighed a plate first."""

    driver = "scale"
    models = ("scale",)
    stations = (Station("pan"),)

    async def connect(self) -> None:
        assert self.setup.world is not None
        self.world: World = self.setup.world

    @action(Needs(), duration_s=5)
    async def weigh(self, whose: str) -> None:
        """Weigh the plate of somebody."""
        pan = self.setup.place("pan")
        plate = (self.world.at(pan) or [""])[-1]
        before = [m.facts["whose"] for m in self.world.motions("weigh") if m.plate == plate]
        if before and before[0] != whose:
            self.world.crash(self.setup.name, pan, f"weighs the plate of {before[0]} for {whose}")
        self.world.work(self.setup.name, "weigh", pan, whose=whose)

    @action(duration_s=600)
    async def calibrate(self) -> None:
        """Weigh nothing for a while."""
        await asyncio.sleep(600)


CORNER = Corner(
    """
labos: 1
name: corner
modules:
  - {name: left, model: sciclops}
  - {name: ur, model: ur5}
  - {name: scale, driver: scale}
stations:
  wc.a: {}
  wc.gate: {}
  wc.trash: {kind: waste}
stock:
  left.tower1: {plate96: 20}
""",
    Scale,
)


def weigh_steps(whose: str, source: str, target: str) -> tuple[str, ...]:
    return (
        f"ur.transfer source={source} target=scale.pan",
        f"scale.weigh whose={whose}",
        f"ur.transfer source=scale.pan target={target}",
    )


LEAVES = CORNER.run("leaves", "left.get_plate loc=tower1", *weigh_steps("ada", "left.exchange", "wc.a"))
FETCHES = CORNER.run("fetches", *weigh_steps("ada", "wc.a", "wc.trash"))
TAKES = CORNER.run("takes", *weigh_steps("bo", "wc.a", "wc.trash"), user="bo")


def give_over(seed: int) -> tuple[set[str], list[str]]:
    """Ada leaves a plate between two runs, and somebody else has an eye on it."""
    lab = SimulatedLab(CORNER.stand, seed, QUIET)
    try:
        ada = Job("ada", "ada", (LEAVES, FETCHES))
        lab.run_for([ada, Job("bo", "bo", (TAKES,))], 4 * 3600.0)
        return lab.done_jobs, [m.facts["what"] for m in lab.world.crashes()]
    finally:
        lab.close()


def test_what_a_run_leaves_is_its_users() -> None:
    for seed in range(2):
        assert give_over(seed) == ({"ada"}, [])


def test_what_would_be_everybodys_is_taken_by_somebody_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("labos.core.decide.endings.user_owner", lambda user: SHARED)
    assert any("weighs the plate of ada for bo" in give_over(seed)[1] for seed in range(4))


PARKS = CORNER.run("parks", "left.get_plate loc=tower1", "ur.transfer source=left.exchange target=wc.a")
THINKS = CORNER.run("thinks", "scale.calibrate")
CLEARS = CORNER.run(
    "clears", "ur.transfer source=wc.a target=wc.gate", "ur.transfer source=wc.gate target=wc.trash"
)
STAYS = CORNER.run(
    "stays",
    "left.get_plate loc=tower1",
    "ur.transfer source=left.exchange target=wc.gate",
    user="bo",
)


def park(seed: int, rates: FaultRates = QUIET) -> None:
    """An experiment whose way out is the gate, and a run that comes to rest in it. Raises Stalled."""
    start = StartExperiment("parks", "ada", CLEARS.plan, parking=(StationName("corner/wc.a"),))
    lab = SimulatedLab(CORNER.stand, seed, rates)
    try:
        other = Job("bo", "bo", (STAYS,), after_s=60.0)
        state = lab.run([Job("ada", "ada", (PARKS, THINKS), start), other], limit_s=24 * 3600.0)
        assert lab.differences(state) == []
    finally:
        lab.close()


@pytest.mark.parametrize("rates", [QUIET, STORMY], ids=["quiet", "stormy"])
def test_the_closing_workflow_can_always_be_run(rates: FaultRates) -> None:
    for seed in range(3):
        park(seed, rates)


def test_who_forgets_that_experiments_close_shuts_their_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("labos.planning.safety._make_closing", lambda path: ())
    with pytest.raises(Stalled):
        park(0)
