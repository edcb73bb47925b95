"""A hotel into which an arm reaches: every plate on a shelf of its own, and it is taken from there again."""

from __future__ import annotations

from collections.abc import Collection

import msgspec
import pytest

from labos.core import shelves
from labos.core.bench import Bench
from labos.core.decide.runs import SubmitRun
from labos.core.effects import AnyEffect, Move
from labos.core.ids import StationName
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
  - {name: one, model: hidex}
  - {name: two, model: hidex}
stations:
  wc.hotel: {shelves: 3}
  wc.trash: {kind: waste}
stock:
  left.tower1: {plate96: 20}
  right.tower1: {plate96: 20}
""")
HOTEL = StationName("corner/wc.hotel")


def stay(stack: str, reader: str, user: str) -> SubmitRun:
    """A plate goes to the hotel, is read, goes to the hotel again and is thrown away."""
    return CORNER.run(
        f"{stack} {reader}",
        f"{stack}.get_plate loc=tower1",
        f"ur.transfer source={stack}.exchange target=wc.hotel",
        f"{reader}.open_lid",
        f"ur.transfer source=wc.hotel target={reader}.default",
        f"{reader}.close_lid",
        f"{reader}.run_assay assay_name=od600",
        f"{reader}.open_lid",
        f"ur.transfer source={reader}.default target=wc.hotel",
        f"{reader}.close_lid",
        "ur.transfer source=wc.hotel target=wc.trash",
        user=user,
    )


RUNS = [
    stay("left", "one", "ada"),
    stay("right", "two", "bo"),
    stay("left", "two", "cy"),
    stay("right", "one", "ada"),
    stay("left", "one", "di"),
]


@few_and_many(1, 6)
def test_every_plate_has_a_shelf_of_its_own(seeds: range) -> None:
    for seed in seeds:
        state = CORNER.live_through(RUNS, seed)
        assert state.bench.stations[HOTEL].count == 0


@pytest.mark.slow
def test_in_a_storm_too() -> None:
    for seed in range(6):
        CORNER.live_through(RUNS, seed, STORMY)


@pytest.mark.slow
def test_without_looking_for_a_free_shelf_plates_are_put_on_plates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shelves, "list_vacant", lambda bench, hotel: bench.shelves[hotel])
    monkeypatch.setattr("labos.runtime.kernel.find_broken_by", lambda state, events: "")
    for seed in range(3):
        crashes = CORNER.crashes(RUNS, seed)
        assert any("plate" in crash and "wc.hotel.1" in crash for crash in crashes), f"seed {seed}: {crashes}"


@pytest.mark.full
def test_where_the_lowest_plate_is_taken_it_is_somebody_elses(monkeypatch: pytest.MonkeyPatch) -> None:
    really = shelves.on_shelves

    def lowest(bench: Bench, effect: AnyEffect, but: Collection[StationName]) -> AnyEffect:
        found = really(bench, effect, but)
        if not isinstance(found, Move) or getattr(effect, "source", "") != HOTEL:
            return found
        taken = next(shelf for shelf in bench.shelves[HOTEL] if bench.stations[shelf].labware)
        return msgspec.structs.replace(found, source=taken)

    monkeypatch.setattr("labos.core.binding.on_shelves", lowest)
    wrong = [CORNER.run_anyhow(RUNS, seed) for seed in range(6)]
    assert any(crashes or differ for crashes, differ in wrong)
