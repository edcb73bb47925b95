"""How long actions take is learned from the log, and anybody who folds it knows the same."""

from __future__ import annotations

import pytest

from labos.core.lengths import ENOUGH, KEPT, find_drifts
from labos.core.model import Plan
from labos.planning.forecast import MARGIN, find_longest_time, find_spread, find_usual_time
from tests.support.bench import SECOND, Driver, full, module, plan, refold, station, step, workcell

CELL = workcell([module("dev"), module("cam")], [station("dev.nest")])


def work(seconds: float = 10.0, **args: object) -> Plan:
    return plan(step("dev", duration_s=seconds, args=args), name="work")


def carry_out(lab: Driver, what: Plan, takes_s: float) -> None:
    run = lab.submit(what)
    action = lab.start(run)
    lab.wait(takes_s)
    lab.finish(action)


def test_what_was_planned_counts_until_there_are_enough_times() -> None:
    lab, what = Driver(CELL), work()
    for takes in (14.0,) * (ENOUGH - 1):
        carry_out(lab, what, takes)
    assert find_usual_time(lab.state, what.steps[0]) == 10 * SECOND
    assert find_longest_time(lab.state, what.steps[0]) == 11 * SECOND
    carry_out(lab, what, 15.0)
    assert find_usual_time(lab.state, what.steps[0]) == 14 * SECOND
    assert find_longest_time(lab.state, what.steps[0]) == pytest.approx(14 * MARGIN * SECOND)
    carry_out(lab, what, 20.0)
    assert find_longest_time(lab.state, what.steps[0]) == 20 * SECOND
    shortest = find_longest_time(lab.state, what.steps[0]) - find_spread(lab.state, what.steps[0])
    assert shortest == pytest.approx(15 * (2 - MARGIN) * SECOND)


def test_the_log_alone_tells_it_again() -> None:
    lab = Driver(CELL)
    for number in range(KEPT + 5):
        carry_out(lab, work(n=number % 3), 10.0 + number)
    again = refold(lab.log)
    assert again.lengths == lab.state.lengths
    assert all(len(times.took) <= KEPT for times in again.lengths.by_kind.values())
    lab.check_log()


def test_arguments_count_and_new_ones_take_as_long_as_others() -> None:
    lab = Driver(CELL)
    for _ in range(ENOUGH):
        carry_out(lab, work(program=1), 5.0)
        carry_out(lab, work(program=2), 50.0)
    assert find_usual_time(lab.state, work(program=1).steps[0]) == 5 * SECOND
    assert find_usual_time(lab.state, work(program=2).steps[0]) == 50 * SECOND
    slower = find_usual_time(lab.state, work(20.0, program=3).steps[0])
    assert slower in (10 * SECOND, 100 * SECOND)  # half or five times of what was planned, as of the others
    assert find_usual_time(lab.state, plan(step("cam", duration_s=7.0)).steps[0]) == 7 * SECOND


def test_one_interruption_does_not_make_everybody_wait() -> None:
    lab, what = Driver(CELL), work()
    for takes in (10.0, 10.0, 10.0, 3600.0):
        carry_out(lab, what, takes)
    assert find_usual_time(lab.state, what.steps[0]) == 10 * SECOND
    assert find_longest_time(lab.state, what.steps[0]) < 21 * SECOND


def test_what_a_person_does_or_nobody_knew_tells_nothing() -> None:
    lab = Driver(CELL)
    by_hand = plan(step("dev", duration_s=10.0, by_person=True))
    run = lab.submit(by_hand)
    lab.wait(900.0)
    lab.finish(lab.start(run))
    assert lab.state.lengths.by_kind == {}


def test_an_action_that_takes_longer_than_planned_is_told() -> None:
    lab = Driver(CELL)
    for _ in range(ENOUGH):
        carry_out(lab, work(10.0), 14.0)
        carry_out(lab, plan(step("cam", duration_s=10.0)), 10.5)
    [found] = find_drifts(lab.state.lengths, 1.0)
    assert (found.module, found.action, found.takes_s, found.planned_s) == (full("dev"), "act", 14.0, 10.0)
