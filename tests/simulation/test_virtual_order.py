"""A forecast follows the order that the lab has found by itself (``own_order``)."""

from __future__ import annotations

import random

import pytest

from labos.core.ids import RunId
from labos.core.runs import RunCompleted
from labos.core.state import encode_picture, from_picture
from labos.planning.scheduler import make_searching_scheduler
from labos.planning.virtual import VirtualLab
from tests.support.bench import SECOND
from tests.unit.planning.test_own_order import make_cell
from tests.unit.planning.timed import TimedDriver

SEEDS = range(12)


class Shop(TimedDriver):
    """A lab that looks for orders of its own, with four to six runs that wait."""

    def __init__(self, seed: int) -> None:
        rng = random.Random(f"forecast/{seed}")
        cell, ways = make_cell(rng)
        super().__init__(cell)
        self.scheduler = make_searching_scheduler()
        self.stock("stack", 40)
        self.ways = [*ways, *ways][: rng.randint(4, 6)]
        for way in self.ways:
            self.submit(way)


def foresee(lab: Shop, *, by_age: bool = False) -> dict[RunId, int]:
    """When runs end by a forecast that knows what the lab knows, or by one of a lab without such orders."""
    state = from_picture(encode_picture(lab.state))
    orders = None if by_age else lab.scheduler.adviser.own.known
    play = VirtualLab(state, lab.now, lambda _, step: int(step.duration_s * SECOND), orders=orders).go_on()
    assert not play.stays
    return play.ends


@pytest.mark.parametrize("seed", SEEDS)
def test_a_forecast_of_runs_that_were_just_submitted_is_what_comes(seed: int) -> None:
    lab = Shop(seed)
    told = foresee(lab)
    lab.go_on()
    assert told == lab.find_times(RunCompleted)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_forecast_in_the_midst_of_the_work_is_what_comes(seed: int) -> None:
    lab = Shop(seed)
    asked: list[dict[RunId, int]] = []
    for turns in (3, 37, 6, 6, 6, 6):
        lab.go_on(turns)
        asked.append(foresee(lab))
    lab.go_on()
    came = lab.find_times(RunCompleted)
    assert len(came) == len(lab.ways)
    for told in asked:
        assert told == {run: came[run] for run in told}


def test_a_forecast_that_does_not_know_the_order_is_wrong() -> None:
    """Else the tests above show nothing."""
    wrong = 0
    for seed in SEEDS:
        lab = Shop(seed)
        told = foresee(lab, by_age=True)
        lab.go_on()
        wrong += told != lab.find_times(RunCompleted)
    assert wrong >= len(SEEDS) // 2
