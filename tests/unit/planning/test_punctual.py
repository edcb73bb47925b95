"""A suggested order that goes as suggested is followed to the letter, and shows a way to the end."""

from __future__ import annotations

import pytest

from labos.core.ids import RunId
from labos.planning.layout import lay_out
from labos.planning.punctual import PunctualOrders
from labos.planning.suggested_way import follow_order
from tests.support.bench import SECOND, Driver
from tests.unit.planning.test_arrival import QUICK, SLOW, at_work
from tests.unit.planning.test_suggested import CELL, dose_and_read, suggest, visit

TIMES_S = (0.0, 10.0, 110.0, 120.0, 220.0)
"""When the steps of a run that doses and reads may start, if it is alone."""


def lab_with_order(*late_s: float) -> tuple[Driver, list[RunId]]:
    """Runs with windows, in an order in which each starts so many seconds after now."""
    lab = Driver(CELL)
    lab.stock("stack", 80)
    runs = [lab.submit(dose_and_read()) for _ in late_s]
    steps = [
        (run, i, late + at) for run, late in zip(runs, late_s, strict=True) for i, at in enumerate(TIMES_S)
    ]
    suggest(lab, *sorted(steps, key=lambda one: one[2]))
    return lab, runs


def starts(lab: Driver, orders: PunctualOrders) -> dict[tuple[str, int], int] | None:
    return orders.find_starts(lab.state, "cell", lab.now)


def test_an_order_that_keeps_all_windows_says_when_each_step_starts() -> None:
    lab, (first, second) = lab_with_order(0.0, 130.0)
    found = starts(lab, PunctualOrders())
    assert found is not None
    assert found[first, 3] - lab.now == 120 * SECOND
    assert found[second, 0] - lab.now == 130 * SECOND


def test_an_order_that_two_need_the_same_module_for_is_not_followed() -> None:
    lab, _ = lab_with_order(0.0, 50.0)
    assert starts(lab, PunctualOrders()) is None


def test_it_is_followed_only_while_all_goes_as_suggested() -> None:
    lab, (first, _) = lab_with_order(0.0, 130.0)
    orders = PunctualOrders()
    assert lab.pump() == [f"{first}#0"]
    assert starts(lab, orders) is not None
    lab.wait(10.0)
    lab.finish(lab.list_flying()[0])
    lab.pump()
    assert starts(lab, orders) is not None
    lab.wait(101.0)
    assert starts(lab, orders) is None, "what is in flight should have ended a second ago"


@pytest.mark.parametrize("took_s", [60.0, 100.0])
def test_it_is_not_followed_to_the_letter_where_a_clock_runs_out_before(took_s: float) -> None:
    lab = Driver(CELL)
    lab.stock("stack", 80)
    run = lab.submit(dose_and_read())
    suggest(lab, *((run, i, at) for i, at in enumerate((0.0, 10.0, 110.0, 200.0, 300.0))))
    orders = PunctualOrders()
    for seconds in (10.0, took_s):
        assert starts(lab, orders) is not None
        lab.pump()
        lab.wait(seconds)
        lab.finish(lab.list_flying()[0])
    is_kept = took_s == 100.0
    assert (starts(lab, orders) is not None) is is_kept, "the plate is to be read within 120 s"


def test_it_is_not_followed_where_somebody_is_inside_whom_it_does_not_name() -> None:
    lab, (first, _) = lab_with_order(0.0, 130.0)
    lab.submit(visit("other"))
    orders = PunctualOrders()
    assert starts(lab, orders) is not None, "that run waits outside"
    lab.start(lab.submit(visit("other")))
    assert starts(lab, orders) is None
    assert first in lab.state.runs.queued


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_suggested_order_is_a_way_to_the_end(order: tuple[int, int]) -> None:
    lab = Driver(CELL)
    lab.stock("stack", 80)
    runs = [lab.submit(visit(name)) for name in ("dev", "other")]
    for run in runs:
        lab.finish(lab.start(run))
        lab.finish(lab.start(run, 1))
    first, second = (runs[number] for number in order)
    suggest(lab, (first, 2, 0.0), (first, 3, 100.0), (second, 2, 200.0), (second, 3, 300.0))
    safety = lab.scheduler.safety
    actors = safety.list_actors(lab.state, "cell")
    floor = lay_out(lab.state, "cell", actors, hopeful=True)
    way = follow_order(lab.state, "cell", floor, actors, set(runs))
    assert way is not None
    assert list(dict.fromkeys(name for name, _ in way)) == [first, second]
    assert follow_order(lab.state, "cell", floor, actors, {*runs, "a stranger"}) is None


def test_an_order_that_leads_nowhere_is_no_way() -> None:
    lab = Driver(CELL)
    lab.stock("stack", 80)
    run = lab.submit(visit("dev"))
    lab.finish(lab.start(run))
    suggest(lab, (run, 3, 0.0), (run, 1, 100.0))
    actors = lab.scheduler.safety.list_actors(lab.state, "cell")
    floor = lay_out(lab.state, "cell", actors, hopeful=True)
    assert follow_order(lab.state, "cell", floor, actors, {run}) is None


def test_a_run_that_waits_outside_is_let_in_at_its_time() -> None:
    """No event marks that time: the run ahead works for ten minutes."""
    lab = at_work(SLOW, QUICK)
    run = next(name for name, waits in lab.state.runs.queued.items() if lab.state.runs.plan_of(waits) == SLOW)
    suggest(lab, (run, 0, 30.0), (run, 1, 600.0))
    assert f"{run}#0" not in lab.pump()
    assert lab.scheduler.find_next_wake() == lab.now + 30 * SECOND
    lab.wait(30.0)
    assert lab.pump() == [f"{run}#0"]
