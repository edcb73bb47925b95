"""The times of an order are made exact, and windows that cannot be kept do not count against it."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from labos.core.ids import RunId
from labos.core.model import Plan, Window
from labos.core.suggestions import OrderSuggested, Suggested
from labos.planning.forecast import find_unavoidable_delay
from labos.planning.punctual import PunctualOrders
from labos.planning.retiming import correct_times
from tests.support.bench import SECOND, Driver
from tests.unit.planning.test_suggested import CELL, dose_and_read, suggest


def read_within(within_s: float) -> Plan:
    """The reader has to follow the dispenser so soon; the arm takes ten seconds for the way."""
    plan = dose_and_read()
    steps = list(plan.steps)
    steps[3] = replace(steps[3], windows=(Window(1, 0.0, within_s),))
    return replace(plan, steps=tuple(steps))


def lab_with(*plans: Plan) -> tuple[Driver, list[RunId]]:
    lab = Driver(CELL)
    lab.stock("stack", 80)
    return lab, [lab.submit(plan) for plan in plans]


def make_order(lab: Driver, times_s: dict[RunId, tuple[float, ...]], first: int = 0) -> OrderSuggested:
    """Runs with the times of their steps from ``first`` on, in seconds from now."""
    steps = [
        Suggested(run, index, lab.now + int(at * SECOND))
        for run, times in times_s.items()
        for index, at in enumerate(times, first)
    ]
    return OrderSuggested(
        "cell", "labos", lab.now + 600 * SECOND, tuple(sorted(steps, key=lambda s: s.start))
    )


def list_times(lab: Driver, order: OrderSuggested, run: RunId) -> tuple[float, ...]:
    found = sorted((one.step, one.start) for one in order.steps if one.run == run)
    return tuple((start - lab.now) / SECOND for _, start in found)


def test_exact_times_stay() -> None:
    lab, (first, second) = lab_with(dose_and_read(), dose_and_read())
    order = make_order(lab, {first: (0, 10, 110, 120, 220), second: (120, 130, 230, 240, 340)})
    assert correct_times(lab.state, order, lab.now) == order


def test_a_step_that_cannot_start_at_its_time_gets_a_later_one() -> None:
    lab, (first, second) = lab_with(dose_and_read(), dose_and_read())
    order = make_order(lab, {first: (0, 10, 110, 120, 220), second: (117, 127, 227, 237, 337)})
    found = correct_times(lab.state, order, lab.now)
    assert list_times(lab, found, first) == (0, 10, 110, 120, 220)
    assert list_times(lab, found, second) == (120, 130, 230, 240, 340)
    assert [one.start for one in found.steps] == sorted(one.start for one in found.steps)
    assert found.until - order.until == 3 * SECOND


def test_a_clock_starts_later_if_its_window_would_be_missed() -> None:
    lab, (first, second) = lab_with(dose_and_read(), read_within(20.0))
    order = make_order(lab, {first: (0, 10, 110, 140, 240), second: (120, 130, 230, 240, 340)})
    found = correct_times(lab.state, order, lab.now)
    assert list_times(lab, found, second) == (120, 140, 250, 260, 360), "the first one leaves after 250 s"


def test_a_clock_that_runs_cannot_start_later() -> None:
    lab, (first, second) = lab_with(dose_and_read(), read_within(20.0))
    for run, steps in ((first, (0, 1, 2, 3)), (second, (0, 1))):
        for index in steps:
            action = lab.start(run, index)
            if (run, index) != (first, 3):
                lab.finish(action)
    order = make_order(lab, {first: (), second: (0, 10, 110)}, first=2)
    steps = (*order.steps, Suggested(first, 4, lab.now + 100 * SECOND))
    order = replace(order, steps=tuple(sorted(steps, key=lambda one: one.start)))
    assert correct_times(lab.state, order, lab.now) is order


def test_an_order_that_leaves_out_a_step_stays() -> None:
    lab, (first,) = lab_with(dose_and_read())
    order = make_order(lab, {first: (0, 5, 100)})
    assert correct_times(lab.state, order, lab.now) is order


def test_an_order_without_steps_stays() -> None:
    """No run fits in, as long as a stranger's plate stands in the way."""
    lab, _ = lab_with(dose_and_read())
    order = make_order(lab, {})
    assert correct_times(lab.state, order, lab.now) is order


@pytest.mark.parametrize("within_s", [5.0, 9.0])
def test_a_window_that_no_order_can_keep_does_not_count(within_s: float) -> None:
    lab, (first, second) = lab_with(read_within(within_s), read_within(within_s))
    times = {first: (0.0, 10.0, 110.0, 120.0, 220.0), second: (117.0, 127.0, 227.0, 237.0, 337.0)}
    found = correct_times(lab.state, make_order(lab, times), lab.now)
    assert list_times(lab, found, second) == (120, 130, 230, 240, 340)
    suggest(lab, *((one.run, one.step, (one.start - lab.now) / SECOND) for one in found.steps))
    orders = PunctualOrders()
    assert orders.find_starts(lab.state, "cell", lab.now) is not None
    for seconds in (10.0, 100.0):
        lab.pump()
        lab.wait(seconds)
        lab.finish(lab.list_flying()[0])
        assert orders.find_starts(lab.state, "cell", lab.now) is not None, "it goes as suggested"


def test_it_does_not_count_while_a_step_is_in_flight_and_the_next_one_waits_either() -> None:
    lab, (run,) = lab_with(read_within(5.0))
    lab.start(run)
    order = make_order(lab, {run: (30, 130, 140, 237)}, first=1)
    assert list_times(lab, correct_times(lab.state, order, lab.now), run) == (30, 130, 140, 240)


@pytest.mark.parametrize(("within_s", "excess_s"), [(30.0, 0.0), (10.0, 0.0), (4.0, 6.0)])
def test_the_excess_is_what_the_steps_within_take_too_long(within_s: float, excess_s: float) -> None:
    lab, (run,) = lab_with(read_within(within_s))

    def excess() -> float:
        flying = {lab.state.actions.open[a].step: lab.state.actions.open[a] for a in lab.list_flying()}
        steps = lab.state.runs.plan_of(lab.run(run)).steps
        ends = {
            index: action.requested_at + int(steps[index].duration_s * SECOND)
            for index, action in flying.items()
        }
        return find_unavoidable_delay(lab.state, lab.run(run), 3, ends, lab.now) / SECOND

    assert excess() == excess_s, "before the run starts"
    lab.finish(lab.start(run, 0))
    action = lab.start(run, 1)
    assert excess() == excess_s, "before the clock starts"
    lab.wait(100.0)
    lab.finish(action)
    lab.start(run, 2)
    assert excess() == excess_s, "while the clock runs"
    lab.wait(3.0)
    assert excess() == excess_s
