"""Labware that was handed over is its new owner's: his runs take it, and those of who gave it do not. The
scale keeps its own account of whose plate it is, from the people who stand at the bench."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from msgspec.structs import replace

from labos.core.decide._base import DECIDERS
from labos.core.decide.handover import HandOver
from labos.core.ids import LabwareId, Owner
from labos.core.labware import LabwareHandedOver
from labos.core.state import LabState
from labos.node import Needs, Node, Station, World, action
from labos.testing.faults import QUIET, FaultRates
from labos.testing.lab import Job, SimulatedLab
from tests.simulation.corners import Corner
from tests.support.seeds import quiet_and_stormy


class Scale(Node):
    """Crashes when it weighs for somebody what was given to somebody else."""

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
        given = [motion.facts["to"] for motion in self.world.motions("give") if motion.plate == plate]
        if given and given[-1] != whose:
            self.world.crash(self.setup.name, pan, f"weighs for {whose} what was given to {given[-1]}")
        self.world.work(self.setup.name, "weigh", pan, whose=whose)


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
  wc.b: {}
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


LEAVES = CORNER.run("leaves", "left.get_plate loc=tower1", "ur.transfer source=left.exchange target=wc.a")
ADA = CORNER.run("ada", *weigh_steps("ada", "wc.a", "wc.b"))
BO = CORNER.run("bo", *weigh_steps("bo", "wc.a", "wc.trash"), user="bo")
A_WHILE_S = 1200.0
"""After which everybody wants the plate."""


class Giving(SimulatedLab):
    """Ada gives her plate to Bo as soon as it stands there, over the bench and in the log."""

    async def _act_as_person(self) -> None:
        self._people.append(self.loop.create_task(self._ada()))
        await super()._act_as_person()

    async def _ada(self) -> None:
        def rests(state: LabState) -> bool:
            plate = state.bench.labware.get(LabwareId("P1"))
            return plate is not None and plate.owner == "user:ada" and plate.station == "corner/wc.a"

        await self._await(rests)
        self.world.work("ada", "give", "wc.a", to="bo")
        await self._insist(HandOver(LabwareId("P1"), Owner("user:bo"), "ada"))


def give_over(seed: int, rates: FaultRates = QUIET) -> tuple[set[str], list[str]]:
    """Whose runs came to their end, and what the scale crashed with."""
    lab = Giving(CORNER.stand, seed, rates)
    try:
        later = [Job("ada", "ada", (ADA,), after_s=A_WHILE_S), Job("bo", "bo", (BO,), after_s=A_WHILE_S + 60)]
        lab.run_for([Job("leaves", "ada", (LEAVES,)), *later], 4 * 3600.0)
        return lab.done_jobs, [motion.facts["what"] for motion in lab.world.crashes()]
    finally:
        lab.close()


@quiet_and_stormy
def test_what_was_given_is_its_new_owners(rates: FaultRates) -> None:
    for seed in range(3):
        assert give_over(seed, rates) == ({"leaves", "bo"}, [])


def test_a_word_without_an_event_leaves_the_plate_to_its_giver(monkeypatch: pytest.MonkeyPatch) -> None:
    """Switched off: it is answered as done, and the plate stays whose it was."""
    mutate(monkeypatch, lambda event: [])
    for seed in range(2):
        assert give_over(seed)[1] == ["weighs for ada what was given to bo"], f"seed {seed}"


def test_what_is_given_to_everybody_instead_is_taken_by_the_giver(monkeypatch: pytest.MonkeyPatch) -> None:
    """Switched off: whom it was given to."""
    mutate(monkeypatch, lambda event: [replace(event, owner=Owner("shared"))])
    for seed in range(2):
        assert give_over(seed)[1] == ["weighs for ada what was given to bo"], f"seed {seed}"


def mutate(
    monkeypatch: pytest.MonkeyPatch, change: Callable[[LabwareHandedOver], list[LabwareHandedOver]]
) -> None:
    real = DECIDERS[HandOver]

    def hand_over(state: LabState, command: HandOver) -> Any:
        found = real(state, command)
        return change(found[0]) if isinstance(found, list) and found else found  # type: ignore[arg-type]

    monkeypatch.setitem(DECIDERS, HandOver, hand_over)
