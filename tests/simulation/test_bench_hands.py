"""A plate in the hand between two steps: the arm grips nothing else meanwhile."""

from __future__ import annotations

import pytest

from labos.core import binding
from labos.testing.faults import STORMY
from tests.simulation.corners import Corner
from tests.support.seeds import few_and_many

CORNER = Corner("""
labos: 1
name: corner
modules:
  - {name: left, model: sciclops}
  - {name: right, model: sciclops}
  - {name: ur, model: ur5}
  - {name: reader, model: hidex}
stations:
  wc.a: {}
  wc.trash: {kind: waste}
stock:
  left.tower1: {plate96: 20}
  right.tower1: {plate96: 20}
""")

PICKED = CORNER.run(
    "picked",
    "left.get_plate loc=tower1",
    "ur.pick source=left.exchange",
    "reader.close_lid",
    "reader.open_lid",
    "ur.place target=wc.a",
    "ur.pick source=wc.a",
    "ur.place target=wc.trash",
)
CARRIED = CORNER.run(
    "carried", "right.get_plate loc=tower1", "ur.transfer source=right.exchange target=wc.trash"
)
RUNS = [PICKED, CARRIED] * 3


@few_and_many(1, 4)
def test_what_is_in_the_hand_is_put_down_first(seeds: range) -> None:
    for seed in seeds:
        CORNER.live_through(RUNS, seed)


@pytest.mark.slow
def test_in_a_storm_too() -> None:
    for seed in range(6):
        CORNER.live_through(RUNS, seed, STORMY)


@pytest.mark.slow
def test_without_the_rule_it_grips_with_a_full_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(binding, "check_hand", lambda state, step, source: None)
    monkeypatch.setattr("labos.planning.moves.Mover.check_hand", lambda self, what: None)
    for seed in range(3):
        crashes = CORNER.crashes(RUNS, seed)
        assert any("grips with a full hand" in crash for crash in crashes), f"seed {seed}"
