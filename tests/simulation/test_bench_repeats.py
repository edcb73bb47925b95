"""Steps that are done again, and actions that do not end in time: nothing is done twice that may be done
once. Each of the rules is switched off once, and the bench crashes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Annotated, Any

import pytest
from msgspec.structs import replace

from labos.core.actions import Action
from labos.core.decide import LABOS, Rejection, decide, steps
from labos.core.decide.actions import FinishAction
from labos.core.decide.runs import SubmitRun
from labos.core.model import PlanStep, Retry
from labos.core.registry import Event
from labos.core.state import LabState
from labos.node import DeviceError, Needs, Node, Param, Station, World, action
from labos.testing.faults import QUIET
from labos.testing.lab import SimulatedLab
from tests.simulation.corners import Corner, jobs


class Press(Node):
    """Stamps a plate, once in its life; the first time it is told to it fails."""

    driver = "press"
    models = ("press",)
    stations = (Station("bed"),)

    async def connect(self) -> None:
        assert self.setup.world is not None
        self.world: World = self.setup.world

    @action(Needs(), duration_s=10)
    async def stamp(self, fails: Annotated[str, Param(choices=("before", "after"))]) -> None:
        """Stamp the plate."""
        bed = self.setup.place("bed")
        first = not self.world.motions("try")
        self.world.work(self.setup.name, "try")
        if first and fails == "before":
            raise DeviceError("The stamp is dry.", effects="none")
        plate = (self.world.at(bed) or [""])[-1]
        if self.world.last(plate, "stamp"):
            self.world.crash(self.setup.name, bed, "stamps a stamped plate")
        self.world.work(self.setup.name, "stamp", bed)
        if first:
            raise DeviceError("No word from the stamp.")


CORNER = Corner(
    """
labos: 1
name: corner
modules:
  - {name: left, model: sciclops}
  - {name: ur, model: ur5}
  - {name: press, driver: press}
stations:
  wc.trash: {kind: waste}
stock:
  left.tower1: {plate96: 20}
""",
    Press,
)


class Nobody(SimulatedLab):
    """A lab without people."""

    async def _act_as_person(self) -> None:
        await asyncio.Event().wait()


def make_stamped(fails: str, **more: Any) -> SubmitRun:
    """A plate that is stamped; ``more`` is what the plan says of each step beside."""
    run = CORNER.run(
        f"stamped, fails {fails}",
        "left.get_plate loc=tower1",
        "ur.transfer source=left.exchange target=press.bed",
        f"press.stamp fails={fails}",
        "ur.transfer source=press.bed target=wc.trash",
    )
    return replace(run, plan=replace(run.plan, steps=tuple(map(change_with(more), run.plan.steps))))


def change_with(more: dict[str, Any]) -> Callable[[PlanStep], PlanStep]:
    return lambda step: replace(step, **more) if step.action in ("stamp", "transfer") else step


def run_lab(run: SubmitRun, lab_of: type[SimulatedLab] = SimulatedLab) -> tuple[list[str], list[str]]:
    """How the run ended, and what crashed."""
    lab = lab_of(CORNER.stand, 0, QUIET)
    try:
        lab.run_for(jobs([run]), 2 * 3600.0)
        ended = {"run.completed", "run.failed"}
        ends = [r.head.type for r in lab.store.records if r.head.type in ended and r.head.stream == "R1"]
        return ends, [f"{m.device} {m.facts['what']}" for m in lab.world.crashes()]
    finally:
        lab.close()


AGAIN = Retry(1, 0.0)


def test_what_did_nothing_is_done_again() -> None:
    assert run_lab(make_stamped("before", retry=AGAIN)) == (["run.completed"], [])


def test_what_may_have_been_done_is_not_done_again() -> None:
    assert run_lab(make_stamped("after", retry=AGAIN)) == (["run.failed"], [])


def test_repeated_whatever_it_did_it_does_it_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps, "can_be_repeated", lambda step: True)
    assert "press stamps a stamped plate" in run_lab(make_stamped("after", retry=AGAIN))[1]


def test_what_does_not_end_in_time_is_waited_for() -> None:
    """It counts as unknown; a late word of the node settles it."""
    ends, crashes = run_lab(make_stamped("before", retry=AGAIN, timeout_s=20.0), Nobody)
    assert (ends, crashes) == (["run.completed"], [])


def test_taken_for_not_done_the_arm_grips_empty_air(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(state: LabState, action: Action, why: str) -> list[Event]:
        found = decide(state, FinishAction(action.id, action.attempt, False, "none", error=why), LABOS)
        assert not isinstance(found, Rejection)
        return list(found)

    monkeypatch.setattr(steps, "doubt", fail)
    ends, crashes = run_lab(
        make_stamped("before", retry=replace(AGAIN, delay_s=60.0), timeout_s=20.0), Nobody
    )
    assert any("ur grips empty air" in crash for crash in crashes), (ends, crashes)
