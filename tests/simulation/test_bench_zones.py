"""Two arms over one corner of the table: never both at once."""

from __future__ import annotations

import pytest

from labos.core import rules
from labos.core.decide.runs import SubmitRun
from labos.testing.faults import STORMY
from tests.simulation.corners import Corner

CORNER = Corner("""
labos: 1
name: corner
modules:
  - {name: left, model: sciclops}
  - {name: right, model: sciclops}
  - {name: ur_left, model: ur5}
  - {name: ur_right, model: ur5}
  - {name: reader, model: hidex, zone: middle}
stations:
  wc.a: {zone: middle}
  wc.b: {zone: middle}
  wc.trash: {kind: waste}
stock:
  left.tower1: {plate96: 20}
  right.tower1: {plate96: 20}
""")


def make_carried(side: str, place: str) -> SubmitRun:
    """A plate from a stack through the middle into the waste."""
    return CORNER.run(
        f"by {side}",
        f"{side}.get_plate loc=tower1",
        f"ur_{side}.transfer source={side}.exchange target={place}",
        f"ur_{side}.transfer source={place} target=wc.trash",
    )


RUNS = [make_carried("left", "wc.a"), make_carried("right", "wc.b")] * 3


def test_arms_take_turns_in_a_zone() -> None:
    for seed in range(4):
        CORNER.live_through(RUNS, seed)


def test_in_a_storm_too() -> None:
    for seed in range(4):
        CORNER.live_through(RUNS, seed, STORMY)


@pytest.mark.slow
def test_without_the_rule_they_hit_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rules, "check_zones_free", lambda state, step: None)
    for seed in range(3):
        assert any("hits ur_" in crash for crash in CORNER.crashes(RUNS, seed)), f"seed {seed}"


def test_a_device_with_a_zone_of_its_own_is_in_it_whenever_it_acts(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = CORNER.run("open", *["reader.close_lid", "reader.open_lid"] * 4)
    runs = [make_carried("left", "wc.a"), opened, make_carried("left", "wc.a")]
    CORNER.live_through(runs, 0)
    monkeypatch.setattr(rules, "check_zones_free", lambda state, step: None)
    assert any("hits" in crash for crash in CORNER.crashes(runs, 0))
