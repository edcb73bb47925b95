"""What the lab's own order does to runs that were submitted first."""

from __future__ import annotations

import random

import pytest
from msgspec.structs import replace

from labos.core.ids import RunId
from labos.core.runs import RunStarted
from labos.core.suggestions import OrderSuggested
from labos.planning.outline import Outline, Ways
from labos.planning.own_order import ENOUGH, EQUALLY_OLD_S, GAIN, OwnOrders
from labos.planning.scheduler import Scheduler
from labos.planning.waiting import PATIENCE
from tests.support.bench import CELL, SECOND, Driver, module, station, workcell
from tests.unit.planning.test_own_order import make_cell, make_way
from tests.unit.planning.timed import TimedDriver

SEEDS = range(20)
APART_S = 2 * EQUALLY_OLD_S


def make_lab(seed: int, apart_s: float) -> Driver:
    """Five runs that wait, one submitted so many seconds after the other."""
    rng = random.Random(f"own order/{seed}")
    cell, ways = make_cell(rng)
    lab = Driver(cell)
    lab.careful = False
    lab.stock("stack", 40)
    for way in [*ways, *ways][:5]:
        lab.submit(way)
        lab.wait(apart_s)
    return lab


def find_ends(lab: Driver, own: OwnOrders) -> tuple[dict[RunId, int], dict[RunId, int]] | None:
    """When each run ends by age, and in the order that is found; None if there is none to be followed."""
    waiting = sorted(lab.state.runs.queued.values(), key=lambda run: run.position)
    now = lab.now
    for _ in range(ENOUGH):
        own.search(lab.state, CELL, [], waiting, now)
        goes_on = own.goes_on_at(CELL)
        if goes_on is None:
            break
        now = max(now, goes_on)
    order = own.find(CELL)
    if order is None:
        return None
    by_age = Outline(lab.state, CELL, waiting, now, Ways()).copy().go_on()
    ends: dict[RunId, int] = {}
    for one in order.steps:
        lasts = lab.state.runs.plan_of(lab.run(one.run)).steps[one.step].duration_s
        ends[one.run] = max(ends.get(one.run, 0), one.start + int(lasts * SECOND))
    return {run.id: end for run, end in zip(by_age.runs, by_age.ends, strict=True)}, ends


@pytest.mark.parametrize("seed", SEEDS)
def test_no_run_loses_more_than_all_work_gains(seed: int) -> None:
    lab = make_lab(seed, APART_S)
    found = find_ends(lab, OwnOrders())
    if found is None:
        return
    by_age, ends = found
    gain = max(by_age.values()) - max(ends.values())
    loss = max(ends[run] - by_age[run] for run in ends)
    assert gain - max(0, loss) >= GAIN * (max(by_age.values()) - lab.now) - SECOND


def count(apart_s: float, *, weighs_age: bool) -> tuple[int, int]:
    """In how many labs there is an order to follow, and in how many a run loses more by it than all gain."""
    orders = unfair = 0
    for seed in SEEDS:
        lab = make_lab(seed, apart_s)
        found = find_ends(lab, OwnOrders(weighs_age=weighs_age))
        if found is not None:
            by_age, ends = found
            gain = max(by_age.values()) - max(ends.values())
            orders += 1
            unfair += max(ends[run] - by_age[run] for run in ends) > gain
    return orders, unfair


def test_without_this_rule_runs_lose_more() -> None:
    assert count(APART_S, weighs_age=False)[1] >= len(SEEDS) // 4
    orders, unfair = count(APART_S, weighs_age=True)
    assert orders >= len(SEEDS) // 4, "else the test above shows nothing"
    assert not unfair


def test_which_of_equally_old_runs_ends_first_makes_no_difference() -> None:
    """Runs that were submitted together: more orders are followed than of runs of different age."""
    together, apart = count(0.0, weighs_age=True), count(APART_S, weighs_age=True)
    assert together[0] > apart[0]
    assert together[1], "one of them may lose what another one gains"


class Unfair(OwnOrders):
    """Puts an old run last, whenever there is an order."""

    old = RunId("")

    def find(self, cell: str) -> OrderSuggested | None:
        order = super().find(cell)
        if order is None:
            return None
        late = max((one.start for one in order.steps), default=0) + 3600 * SECOND
        steps = [replace(one, start=late) if one.run == self.old else one for one in order.steps]
        return replace(order, until=2 * late, steps=tuple(sorted(steps, key=lambda one: one.start)))


def test_no_order_lets_more_than_eight_younger_runs_start_first() -> None:
    """As long as younger runs come, an order puts the old one last."""
    cell = workcell(
        [module("arm"), module("mill"), module("oven")],
        [
            station("stack", "stack", 40),
            station("mill.nest", claim=True),
            station("oven.nest", claim=True),
            station("trash", "waste", 99),
        ],
    )
    lab, own = TimedDriver(cell), Unfair()
    lab.scheduler = Scheduler(own)
    lab.stock("stack", 40)
    own.old = lab.submit(make_way(("mill", 300.0), ("oven", 30.0)))
    for number in range(3 * PATIENCE):
        while len(lab.state.runs.queued) < 4 and own.old in lab.state.runs.queued:
            lab.submit(make_way(("mill", 30.0), ("oven", 60.0 + number)))
        lab.go_on(10)
    lab.go_on()
    started = list(lab.find_times(RunStarted))
    assert 1 < started.index(own.old) <= PATIENCE


def test_a_search_goes_on_if_the_clock_is_set_back() -> None:
    lab, own = make_lab(0, APART_S), OwnOrders()
    waiting = sorted(lab.state.runs.queued.values(), key=lambda run: run.position)
    own.search(lab.state, CELL, [], waiting, lab.now)
    tried, now = own.known[CELL].tried, lab.now - 8 * 3600 * SECOND
    for _ in range(2):
        own.search(lab.state, CELL, [], waiting, now)
        now = own.goes_on_at(CELL) or 0
    assert own.known[CELL].tried > tried
    assert now < lab.now


def test_an_order_is_held_against_age_as_it_is_after_the_clock_was_set_back() -> None:
    lab, own = make_lab(0, APART_S), OwnOrders()
    waiting = sorted(lab.state.runs.queued.values(), key=lambda run: run.position)
    own.search(lab.state, CELL, [], waiting, lab.now)
    before, back = own.known[CELL], 8 * 3600 * SECOND
    own.search(lab.state, CELL, [], waiting, lab.now - back)
    assert own.known[CELL].limit == before.limit - back
    assert own.known[CELL].order.until <= before.order.until - back
