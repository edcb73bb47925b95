"""A module is one run's from its first action until its labware has left and its door is at rest.
Each of the rules that make it so is switched off once, and the bench crashes."""

from __future__ import annotations

import pytest

from labos.core import binding, holding
from labos.core.decide.runs import SubmitRun
from labos.core.effects import Needs
from labos.core.model import StationSpec
from labos.node import Node, Station, World, action
from labos.testing.faults import STORMY
from tests.simulation.corners import Corner
from tests.support.seeds import few_and_many


class Balance(Node):
    """Weighs what stands on it against what it was tared for: who tares has to weigh next."""

    driver = "balance"
    models = ("balance",)
    stations = (Station("pan", kind="nest"),)

    async def connect(self) -> None:
        assert self.setup.world is not None
        self.world: World = self.setup.world
        self.pan = self.setup.place("pan")

    @action(duration_s=1)
    async def tare(self) -> None:
        """Count what is on the pan as nothing."""
        self.world.work(self.setup.name, "tare")

    @action(Needs(), duration_s=1)
    async def weigh(self) -> None:
        """Weigh what was put on the pan since it was tared."""
        mine = [m for m in self.world.motions() if m.device == self.setup.name or m.place == self.pan]
        tared = max((m.seq for m in mine if m.verb == "tare"), default=0)
        put = [m for m in mine if m.verb == "release" and m.seq > tared]
        weighed = any(m.verb == "weigh" and m.seq > tared for m in mine)
        if len(put) != 1 or weighed:
            self.world.crash(self.setup.name, self.pan, "weighs with somebody else's tare")
        self.world.work(self.setup.name, "weigh", self.pan)


CORNER = Corner(
    """
labos: 1
name: corner
modules:
  - {name: left, model: sciclops}
  - {name: right, model: sciclops}
  - {name: ur, model: ur5}
  - {name: ur2, model: ur5}
  - {name: sealer, model: A4S_sealer}
  - {name: ot2, model: ot2}
  - {name: cycler, model: biometra}
  - {name: balance, driver: balance}
  - {name: fridge, model: hidex}
stations:
  fridge.default: {kind: hotel}
  wc.trash: {kind: waste}
stock:
  left.tower1: {plate96: 20}
  right.tower1: {plate96: 20}
""",
    Balance,
)


def make_weighed(side: str, arm: str) -> SubmitRun:
    return CORNER.run(
        f"weighed {side}",
        "balance.tare",
        f"{side}.get_plate loc=tower1",
        f"{arm}.transfer source={side}.exchange target=balance.pan",
        "balance.weigh",
        f"{arm}.transfer source=balance.pan target=wc.trash",
    )


WEIGHED = [make_weighed("left", "ur"), make_weighed("right", "ur2")] * 3

DOSED = CORNER.run(
    "dosed",
    "right.get_plate loc=tower1",
    "ur2.transfer source=right.exchange target=ot2.deck1",
    "ot2.run_protocol config_path=p.yaml",
    "ot2.run_protocol config_path=p.yaml",
    "ur2.transfer source=ot2.deck1 target=wc.trash",
)
SEALED = CORNER.run(
    "sealed",
    "left.get_plate loc=tower1",
    "ur.transfer source=left.exchange target=sealer.default",
    "sealer.seal",
    "ur.transfer source=sealer.default target=ot2.deck2",
    *["cycler.close_lid", "cycler.open_lid"] * 2,
    "ur.transfer source=ot2.deck2 target=wc.trash",
)
ON_DECK = [DOSED, SEALED] * 3

CYCLED = CORNER.run(
    "cycled",
    "left.get_plate loc=tower1",
    "ur.transfer source=left.exchange target=cycler.default",
    "cycler.close_lid",
    "cycler.run_program program_n=3",
    "cycler.open_lid",
    "ur.transfer source=cycler.default target=wc.trash",
)
SHUT = CORNER.run("shut", *["cycler.close_lid", "cycler.open_lid"] * 4)
AT_THE_DOOR = [CYCLED, SHUT] * 3

SHELVED = CORNER.run(
    "shelved",
    "left.get_plate loc=tower1",
    "ur.transfer source=left.exchange target=fridge.default",
    "ur.transfer source=fridge.default target=wc.trash",
)
AIRED = CORNER.run("aired", *["fridge.close_lid", "fridge.open_lid"] * 8)
AT_THE_SHELVES = [AIRED, SHELVED, SHELVED]

ALL = {"balance": WEIGHED, "deck": ON_DECK, "door": AT_THE_DOOR, "shelves": AT_THE_SHELVES}


@pytest.mark.parametrize("what", ALL)
@few_and_many(1, 3)
def test_a_module_is_one_runs_until_it_is_left(what: str, seeds: range) -> None:
    for seed in seeds:
        CORNER.live_through(ALL[what], seed)


@pytest.mark.slow
def test_in_a_storm_too() -> None:
    for seed in range(3):
        CORNER.live_through(ON_DECK + AT_THE_DOOR + AT_THE_SHELVES, seed, STORMY)


def has_crashed(what: str, words: str) -> bool:
    """Whether this happens in one of four labs."""
    return any(words in crash for seed in range(4) for crash in CORNER.crashes(ALL[what], seed))


def test_without_claims_tips_go_into_somebody_elses_seal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(holding, "find_other_claimant", lambda state, name, allowed: "")
    monkeypatch.setattr("labos.planning.moves._may_claim", lambda floor, actor, claim: True)
    assert has_crashed("deck", "drives its tips into a seal")


@pytest.mark.slow
def test_without_doors_hands_reach_into_closed_gates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(binding, "check_door_open", lambda state, place: None)
    monkeypatch.setattr(holding, "find_door_leaver", lambda state, name, run: "")
    monkeypatch.setattr("labos.planning.moves._open_to", lambda floor, actor, module: True)
    assert has_crashed("door", "reaches into a closed gate")


def test_shelves_behind_a_door_are_not_reached_into_as_if_they_stood_apart(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(StationSpec, "stands_apart", StationSpec.is_storage)
    assert has_crashed("shelves", "reaches into a closed gate")


def test_without_holds_somebody_weighs_with_anothers_tare(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(holding, "find_holder_by_plan", lambda state, name, run: "")
    monkeypatch.setattr("labos.planning.moves._may_hold", lambda floor, actor, key, value: True)
    monkeypatch.setattr("labos.planning.moves._open_to", lambda floor, actor, module: True)
    assert has_crashed("balance", "weighs with somebody else's tare")
