"""An incubator that chooses the slot itself, says which, and gives any plate back; decks whose slots are
one run's at a time, unless they do not concern each other."""

from __future__ import annotations

import pytest

from labos.core.decide.runs import SubmitRun
from labos.core.ids import StationName
from labos.node import Needs, Node, Place, Station, World, action
from labos.testing.faults import QUIET
from labos.testing.lab import SimulatedLab
from tests.simulation.corners import Corner, jobs

CORNER = Corner("""
labos: 1
name: corner
modules:
  - {name: left, model: sciclops}
  - {name: ur, model: ur5}
  - {name: incubator, model: liconic}
  - {name: reader, model: hidex}
stations:
  wc.trash: {kind: waste}
stock:
  left.tower1: {plate96: 20}
""")


def make_stored(name: str, rounds: int, *end: str) -> SubmitRun:
    return CORNER.run(
        name,
        "left.get_plate loc=tower1",
        "ur.transfer source=left.exchange target=incubator.exchange",
        "incubator.store",
        *["reader.close_lid", "reader.open_lid"] * rounds,
        *end,
    )


OUT = ("incubator.retrieve", "ur.transfer source=incubator.exchange target=wc.trash")
RUNS = [make_stored("long", 4, *OUT), make_stored("short", 1, *OUT), make_stored("stays", 1)] * 2


def test_every_plate_comes_back_from_its_own_slot() -> None:
    for seed in range(3):
        state = CORNER.live_through(RUNS, seed)
        slots = [item.variables["slot"] for item in state.bench.labware.values()]
        assert len(set(slots)) == 2, "what stays has a slot, each its own"


def test_with_a_slot_that_is_not_the_devices_it_grips_empty_air(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("labos.core.decide.outcomes.resolve_value", lambda value, result: "stacker4_slot22")
    assert any("grips empty air" in crash for crash in CORNER.crashes(RUNS, 0))


class Gantry(Node):
    """Works on one of its two slots; a wide one (``wide: true``) sweeps over the other as it does."""

    driver = "gantry"
    models = ("gantry",)
    stations = (Station("one", kind="deck"), Station("two", kind="deck"))

    async def connect(self) -> None:
        assert self.setup.world is not None
        self.world: World = self.setup.world

    @action(Needs(StationName("{slot}")), duration_s=60)
    async def work(self, slot: Place) -> None:
        """Work on what stands in a slot."""
        here = self.setup.place(slot.rpartition(".")[2])
        both = [place for name in ("one", "two") for place in self.world.at(self.setup.place(name))]
        if self.setup.config.get("wide") and len(both) > 1:
            self.world.crash(self.setup.name, here, "sweeps over somebody else's plate")
        self.world.work(self.setup.name, "work", here, beside=len(both))


DECK = """
labos: 1
name: deck
modules:
  - {name: left, model: sciclops}
  - {name: right, model: sciclops}
  - {name: ur, model: ur5}
  - {name: ur2, model: ur5}
  - {name: gantry, driver: gantry, config: {wide: WIDE}}
stations:
  wc.trash: {kind: waste}
SLOTS
stock:
  left.tower1: {plate96: 20}
  right.tower1: {plate96: 20}
"""
FREE = "  gantry.one: {independent: true}\n  gantry.two: {independent: true}"


def run_lab(*, wide: bool, independent: bool) -> tuple[list[str], int]:
    """What crashes when two runs use a slot each, and the most that stood on the deck at work."""
    text = DECK.replace("WIDE", str(wide).lower()).replace("SLOTS", FREE if independent else "")
    corner = Corner(text, Gantry)
    runs = [
        corner.run(
            f"in {slot}",
            f"{side}.get_plate loc=tower1",
            f"{arm}.transfer source={side}.exchange target=gantry.{slot}",
            *[f"gantry.work slot=gantry.{slot}"] * 3,
            f"{arm}.transfer source=gantry.{slot} target=wc.trash",
        )
        for slot, side, arm in (("one", "left", "ur"), ("two", "right", "ur2"))
    ]
    lab = SimulatedLab(corner.stand, 0, QUIET)
    try:
        lab.run_for(jobs(runs), 4 * 3600.0)
        beside = [motion.facts["beside"] for motion in lab.world.motions("work")]
        return [motion.facts["what"] for motion in lab.world.crashes()], max(beside, default=0)
    finally:
        lab.close()


def test_a_deck_is_one_runs_at_a_time_unless_its_slots_are_independent() -> None:
    assert run_lab(wide=True, independent=False) == ([], 1)
    assert run_lab(wide=False, independent=True) == ([], 2), "they work side by side"


def test_slots_that_are_not_independent_and_are_taken_to_be() -> None:
    crashes, _ = run_lab(wide=True, independent=True)
    assert "sweeps over somebody else's plate" in crashes
