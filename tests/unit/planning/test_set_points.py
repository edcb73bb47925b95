"""An oven with four places and one temperature: plates of the same temperature are in it together."""

from __future__ import annotations

import random

import pytest

from labos.core.model import Plan, Window
from labos.core.setups import Setup
from labos.core.state import encode_picture, from_picture
from labos.planning.forecast import find_usual_time
from labos.planning.virtual import Play, VirtualLab
from labos.planning.waiting import PATIENCE
from tests.support.bench import SECOND, Driver, claims, module, move, plan, station, step, take, workcell

WARM_UP = Setup("celsius", 1200.0)
PLACES = 4


def oven(setup: Setup | None = WARM_UP) -> Driver:
    lab = Driver(
        workcell(
            [module("arm"), module("oven", setup=setup)],
            [
                station("stack", "stack", 60),
                station("oven.shelf", "hotel", PLACES),
                station("trash", "waste", 99),
            ],
        )
    )
    lab.stock("stack", 60)
    return lab


def bake(celsius: int, bakes_s: float = 1800.0) -> Plan:
    """Set the oven, bring a plate, fetch it when it is done."""
    return plan(
        step("oven", claims("t", celsius), key="set", args={"celsius": celsius}, duration_s=10.0),
        step("arm", take("stack", "oven.shelf"), key="in", duration_s=20.0),
        step("arm", move("oven.shelf", "trash"), key="out", duration_s=20.0, windows=(Window(1, bakes_s),)),
        name=f"bake at {celsius}",
    )


def play(lab: Driver) -> Play:
    state = from_picture(encode_picture(lab.state))
    return VirtualLab(state, lab.now, lambda _, one: find_usual_time(state, one)).go_on()


def test_plates_of_one_temperature_are_in_together_and_another_one_waits() -> None:
    lab = oven()
    runs = [lab.submit(bake(celsius)) for celsius in (37, 60, 37, 37, 60)]
    told = play(lab)
    assert not told.stays
    first = max(told.ends[run] for run in (runs[0], runs[2], runs[3]))
    second = min(told.starts[run] for run in (runs[1], runs[4]))
    assert second >= first, "a temperature is changed when the last plate of the other one is out"
    assert (first - lab.now) / SECOND < 1200 + 2 * 1800, "all three were in together"


def test_the_oven_is_changed_once_where_it_would_be_changed_again_and_again() -> None:
    ends = []
    for setup in (WARM_UP, None):
        lab = oven(setup)
        for number in range(12):
            lab.submit(bake((37, 60)[number % 2]))
        ends.append((max(play(lab).ends.values()) - lab.now) / SECOND)
    known, unknown = ends
    assert known < 2 * 1200 + 4 * 1900, "two temperatures, and two loads of each"
    assert unknown <= known, "what costs nothing takes no longer"


def test_another_temperature_gets_its_turn() -> None:
    lab = oven()
    lab.submit(bake(37))
    other = lab.submit(bake(60))
    later = [lab.submit(bake(37)) for _ in range(30)]
    told = play(lab)
    assert not told.stays
    before = sum(told.starts[run] < told.starts[other] for run in later)
    assert before <= PATIENCE + PLACES


@pytest.mark.parametrize("seed", range(12))
def test_random_work_comes_to_its_end(seed: int) -> None:
    """Temperatures, users, priorities and due dates at random: nobody stays, nobody is forgotten."""
    rng = random.Random(f"oven/{seed}")
    lab = oven(rng.choice([WARM_UP, WARM_UP, None]))
    lab.careful = seed < 2
    for _ in range(25):
        lab.submit(
            bake(rng.choice([37, 42, 60]), rng.choice([0.0, 2.0])),
            rng.choice(["ada", "bo"]),
            priority=rng.choice([0, 0, 1]),
            due_at=lab.now + rng.randint(-3, 30) * 600 * SECOND if rng.random() < 0.5 else 0,
        )
    told = play(lab)
    assert not told.stays
    assert len(told.ends) == 25
