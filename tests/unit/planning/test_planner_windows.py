"""For runs with windows, a planner suggests an order of runs, and watches whether it has become worse."""

from __future__ import annotations

import pytest

from labos.core.ids import RunId
from labos.core.suggestions import OrderSuggested
from labos.planner.planner import Planner
from labos.planner.watch import list_waiting
from labos.planning.window_order import OWN_WINDOWS
from tests.support.bench import Driver
from tests.unit.planning.test_pilot import CELL, way
from tests.unit.planning.test_planner import find_order
from tests.unit.planning.test_window_order import FROM_LATHE, hurried, mixed_lab, orders_of


def make_planner() -> Planner:
    """One that tries 1,500 orders, and has no other search."""
    return Planner(seconds=0.1, solver=lambda *_: None)


def is_due(planner: Planner, lab: Driver) -> bool:
    return planner.is_due(lab.state, "cell", list_waiting(lab.state, "cell"), lab.now)


def test_the_lab_takes_over_a_better_order_of_runs_and_corrects_it_further() -> None:
    better = 0
    for seed in range(2):
        lab, planner = mixed_lab(seed), make_planner()
        orders = lab.scheduler.window_orders
        _, known = orders.find_best("cell")
        order = find_order(planner, lab)
        assert order is not None
        assert not order.steps
        assert sorted(order.line) == sorted([*lab.state.runs.active, *lab.state.runs.queued])
        lab.do(order)
        lab.pump()
        line, rating = orders.find_best("cell")
        assert rating <= known
        better += rating < known and line == order.line
        assert orders_of(lab)["cell"].by == OWN_WINDOWS
        again = find_order(planner, lab)
        assert again is None or again.line != order.line, "the lab knows that one"
    assert better >= 1


def test_a_new_search_is_worthwhile_if_the_order_has_become_worse() -> None:
    lab, planner = mixed_lab(1), make_planner()
    assert not is_due(planner, lab), "it has not searched yet"
    order = find_order(planner, lab)
    assert order is not None
    lab.do(order)
    assert not is_due(planner, lab)
    action = lab.state.actions.open[lab.list_flying()[0]]
    step = lab.state.runs.plan_of(lab.run(action.run)).steps[action.step]
    lab.wait(step.duration_s)
    assert not is_due(planner, lab), "the step in flight should end now"
    lab.wait(600.0)
    assert is_due(planner, lab), "it takes much longer"


def test_a_new_search_is_worthwhile_for_new_runs() -> None:
    lab, planner = mixed_lab(2), make_planner()
    assert find_order(planner, lab) is not None
    assert not is_due(planner, lab)
    new = lab.submit(hurried(way("new", ("oven", 30.0), ("mill", 30.0))))
    assert is_due(planner, lab)
    order = find_order(planner, lab)
    assert order is not None
    assert new in order.line


def test_runs_that_have_ended_are_no_reason_for_a_suggestion() -> None:
    lab, planner = mixed_lab(3), make_planner()
    order = find_order(planner, lab)
    assert order is not None
    gone = RunId("R999")
    lab.write(OrderSuggested("cell", "planner", order.until, (), (gone, *order.line)))
    assert find_order(planner, lab) is None


@pytest.mark.slow
def test_runs_of_different_ranks_are_judged_by_a_rehearsal() -> None:
    """A timetable knows no ranks. So its order counts only if the rehearsal of the lab is better with it."""
    lab = mixed_lab(4)
    urgent = lab.submit(hurried(way("urgent", ("oven", 30.0), ("lathe", 30.0))), priority=5)
    order = find_order(make_planner(), lab)
    if order is not None and order.line:
        waiting = [run for run in order.line if run in lab.state.runs.queued]
        assert waiting[0] == urgent
    assert order is None or not order.steps


def test_where_the_lab_has_no_order_of_its_own_no_line_is_suggested() -> None:
    lab = Driver(CELL)
    lab.stock("stack", 80)
    lab.submit(way("free", ("mill", 60.0), ("oven", 60.0)))
    lab.submit(FROM_LATHE)
    planner = make_planner()
    order = find_order(planner, lab)
    assert order is None or not order.line
    assert not is_due(planner, lab)
