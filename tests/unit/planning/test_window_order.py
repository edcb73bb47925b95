"""Where clocks run, planning makes an order of its own for who comes in when."""

from __future__ import annotations

import random
import re
from collections.abc import Callable

from msgspec.structs import replace

from labos.core.decide.cancelling import CancelRun
from labos.core.decide.runs import PauseRun, ResumeRun
from labos.core.ids import RunId
from labos.core.model import Plan, Window
from labos.core.suggestions import OrderSuggested, Suggested
from labos.planning.chains import Chain, Fit, Leg, SlotTable
from labos.planning.scheduler import make_searching_scheduler
from labos.planning.waiting import PATIENCE
from labos.planning.window_order import (
    ENOUGH_EACH,
    LONGEST_SEARCH_NS,
    MOST_WAITING,
    OWN_WINDOWS,
    TRIES_EACH,
    TRIES_NEW,
    FittedRun,
    WindowOrders,
    fit_behind,
)
from tests.support.bench import Driver
from tests.unit.planning.test_pilot import CELL, LONG_FIRST, lab_with, way


def hurried(found: Plan, spare_s: float = 15.0) -> Plan:
    """The same way, but each machine has to begin so soon after the one before."""
    steps = list(found.steps)
    for index in range(3, len(steps), 2):
        steps[index] = replace(steps[index], windows=(Window(index - 2, 0.0, 10.0 + spare_s),))
    return replace(found, steps=tuple(steps))


TO_LATHE = hurried(way("to lathe", ("mill", 60.0), ("lathe", 300.0)))
TO_OVEN = hurried(way("to oven", ("mill", 300.0), ("oven", 60.0)))
FROM_LATHE = hurried(way("from lathe", ("lathe", 60.0), ("oven", 300.0)))


def orders_of(lab: Driver) -> dict[str, OrderSuggested]:
    return lab.scheduler.window_orders.orders


def go_on(lab: Driver, interfere: Callable[[], None] = lambda: None) -> None:
    """Let everything end after the time that it should take, to the end of all."""
    ends: dict[str, int] = {}
    while True:
        interfere()
        lab.pump()
        for action in lab.list_flying():
            found = lab.state.actions.open[action]
            step = lab.state.runs.plan_of(lab.run(found.run)).steps[found.step]
            ends.setdefault(action, found.requested_at + int(step.duration_s * 1e9))
        wake = lab.scheduler.find_next_deadline(lab.state)
        first = min((at for name, at in ends.items() if name in lab.state.actions.open), default=None)
        if first is None:
            return
        lab.wait((max(lab.now, min(first, wake or first)) - lab.now) / 1e9)
        for action in [a for a in lab.list_flying() if ends[a] <= lab.now]:
            lab.finish(action)


def test_a_run_waits_outside_for_its_time() -> None:
    lab = lab_with(TO_LATHE)
    lab.pump()
    lab.wait(10.0)
    lab.finish(lab.list_flying()[0])
    assert lab.pump() == ["R1#1"]
    lab.submit(FROM_LATHE)
    assert lab.pump() == [], "on the lathe it would be in the way of the first one"
    begins = min(step.start for step in orders_of(lab)["cell"].steps if step.run == "R2")
    assert begins > lab.now
    wait = lab.scheduler.adviser.check_start(lab.state, lab.run("R2"), 0, lab.now)
    assert wait is not None
    assert wait.until == begins
    assert re.fullmatch(r"all work ends sooner if .* starts later \(at about .*\)", wait.reason.sentence)


def test_all_windows_are_kept_and_all_come_to_the_end() -> None:
    lab = lab_with(*[TO_LATHE, TO_OVEN, FROM_LATHE] * 3)
    go_on(lab)
    assert not lab.state.runs.active
    assert not lab.state.runs.queued
    assert "window.breached" not in lab.types()
    assert lab.scheduler.window_orders.tries > 0


def test_no_order_is_made_without_windows_or_for_runs_of_one_kind() -> None:
    lab = lab_with(LONG_FIRST, way("other", ("oven", 10.0)))
    go_on(lab)
    assert lab.scheduler.window_orders.tries == 0
    lab = lab_with(TO_LATHE, TO_LATHE)
    go_on(lab)
    assert lab.scheduler.window_orders.tries == 0


def test_a_planner_s_order_goes_before() -> None:
    lab = lab_with(TO_LATHE, TO_OVEN)
    lab.pump()
    lab.submit(FROM_LATHE)
    lab.pump()
    assert "cell" in orders_of(lab)
    steps = (Suggested(RunId("R3"), 0, lab.now),)
    lab.write(OrderSuggested("cell", "planner", lab.now + 10**12, steps))
    lab.pump()
    assert "cell" not in orders_of(lab)


def find_long(lab: Driver, tries: int) -> tuple[tuple[RunId, ...], tuple[int, int]]:
    """The order of runs that a longer search finds, and its rating."""
    orders = WindowOrders(PATIENCE)
    runs = [*lab.state.runs.list_inside("cell"), *lab.state.runs.queued.values()]
    assert orders.search_longer(lab.state, "cell", runs, lambda _: 0, lab.now, tries) is not None
    return orders.find_best("cell")


def mixed_lab(seed: int) -> Driver:
    """One run inside, and eleven unlike ones that wait."""
    draws = random.Random(f"line/{seed}")
    lab = lab_with(TO_LATHE)
    lab.pump()
    for number in range(11):
        stops = [(name, draws.choice([30.0, 120.0, 240.0])) for name in ("mill", "lathe", "oven")]
        draws.shuffle(stops)
        lab.submit(hurried(way(f"way {number}", *stops)))
    lab.pump()
    return lab


def test_the_search_begins_with_a_suggested_line_and_keeps_what_is_better() -> None:
    better = 0
    for seed in range(2):
        lab = mixed_lab(seed)
        orders = lab.scheduler.window_orders
        _, known = orders.find_best("cell")
        line, rating = find_long(lab, 1500)
        lab.write(OrderSuggested("cell", "planner", lab.now + 10**13, (), line))
        lab.pump()
        assert "cell" in orders_of(lab), "the lab goes on with an order of its own"
        assert orders_of(lab)["cell"].by == OWN_WINDOWS
        assert orders.find_best("cell")[1] <= min(known, rating)
        better += rating < known
        _, known = orders.find_best("cell")
        lab.write(OrderSuggested("cell", "planner", lab.now + 10**13, (), line[::-1]))
        lab.pump()
        assert orders.find_best("cell")[1] <= known, "a worse line changes nothing"
    assert better >= 1


def test_a_line_that_comes_while_a_run_inside_is_paused_is_used_when_it_goes_on() -> None:
    better = 0
    for seed in range(2):
        lab = mixed_lab(seed)
        orders = lab.scheduler.window_orders
        _, known = orders.find_best("cell")
        line, rating = find_long(lab, 1500)
        lab.do(PauseRun(RunId("R1")))
        lab.wait(1.0)
        lab.pump()
        assert "cell" not in orders_of(lab), "nobody knows when the run goes on"
        lab.write(OrderSuggested("cell", "planner", lab.now + 10**13, (), line))
        lab.pump()
        lab.do(ResumeRun(RunId("R1")))
        lab.wait(1.0)
        lab.pump()
        assert "cell" in orders_of(lab), "there is an order again before the next step ends"
        out, end = orders.find_best("cell")[1]
        assert (out, end - 2 * 10**9) <= rating, "as good as the line, two seconds later"
        better += rating < known
    assert better >= 1


def test_bad_lines_stop_nobody() -> None:
    """Lines in any order, of runs that exist or not, again and again."""
    for seed in range(2):
        draws, lab = random.Random(f"lines/{seed}"), lab_with(*[TO_LATHE, TO_OVEN, FROM_LATHE] * 3)

        def interfere(lab: Driver = lab, draws: random.Random = draws) -> None:
            names = [*lab.state.runs.active, *lab.state.runs.queued, RunId("R99")]
            draws.shuffle(names)
            lab.write(OrderSuggested("cell", "planner", lab.now + 10**12, (), tuple(names)))

        go_on(lab, interfere)
        assert not lab.state.runs.active
        assert not lab.state.runs.queued
        assert "window.breached" not in lab.types()


def test_the_order_is_forgotten_when_no_clock_runs() -> None:
    lab = lab_with(TO_LATHE, TO_OVEN)
    go_on(lab)
    assert not orders_of(lab)


def test_a_look_costs_a_bounded_number_of_tries() -> None:
    lab = lab_with(TO_LATHE)
    lab.pump()
    for number in range(2 * MOST_WAITING):
        lab.submit(hurried(way(f"way {number}", ("mill", 30.0 + number), ("oven", 30.0))))
    before = lab.scheduler.window_orders.tries
    lab.pump()
    assert 0 < lab.scheduler.window_orders.tries - before <= max(TRIES_NEW, TRIES_EACH * MOST_WAITING) + 3


def test_the_search_goes_on_while_nothing_happens_and_comes_to_an_end() -> None:
    lab = lab_with(TO_LATHE, TO_OVEN, FROM_LATHE, TO_OVEN)
    lab.pump()
    orders, waits = lab.scheduler.window_orders, len(lab.state.runs.queued)
    looks, ends_before = 0, min(lab.state.actions.open[a].requested_at for a in lab.list_flying()) + 10**10
    while (look := orders.find_next_look()) is not None:
        assert lab.now < look < ends_before, "the kernel is free for other things in between"
        before = orders.tries
        lab.wait((look - lab.now) / 1e9)
        lab.pump()
        assert 0 < orders.tries - before <= TRIES_EACH * waits + 4
        looks += 1
    assert looks > 1
    assert orders.tries >= ENOUGH_EACH * len(lab.state.runs.queued)


def test_what_was_found_later_is_followed_and_no_look_changes_an_order_for_nothing() -> None:
    lab = lab_with(*[TO_LATHE, TO_OVEN, FROM_LATHE] * 3)
    lab.pump()
    first = found = orders_of(lab)["cell"]
    while (look := lab.scheduler.window_orders.find_next_look()) is not None:
        lab.wait((look - lab.now) / 1e9)
        lab.pump()
        before, found = found, orders_of(lab)["cell"]
        ends = [max(step.start for step in order.steps) for order in (before, found)]
        assert found is before or found.steps != before.steps, ends
    last = max(step.start for step in found.steps)
    assert last <= max(step.start for step in first.steps)


def test_a_window_that_is_shorter_than_its_move_leaves_the_others_their_order() -> None:
    too_short = hurried(way("too short", ("mill", 60.0), ("lathe", 300.0)), spare_s=-2.0)
    lab = lab_with(too_short, TO_OVEN, FROM_LATHE)
    lab.pump()
    assert {step.run for step in orders_of(lab)["cell"].steps} == {"R1", "R2", "R3"}


def test_an_order_that_was_lost_is_searched_again_after_the_next_step() -> None:
    lab = lab_with(TO_LATHE, TO_OVEN, FROM_LATHE)
    lab.pump()
    assert "cell" in orders_of(lab)
    lab.do(PauseRun(RunId("R1"), "ada"))
    lab.wait(10.0)
    lab.finish(lab.list_flying()[0])
    lab.pump()
    assert not orders_of(lab), "nobody knows when the first one goes on"
    lab.do(ResumeRun(RunId("R1")))
    lab.pump()
    lab.wait(10.0)
    lab.finish(lab.list_flying()[0])
    lab.pump()
    assert "cell" in orders_of(lab)


def test_a_run_that_cannot_keep_its_window_waits_as_long_as_it_has_to() -> None:
    table = SlotTable(2, 20)
    table.mark(Chain(()), Fit((), 0, ((0, 2, 6),)))
    chain = Chain((Leg((0,), (1,), 3, 0, 1), Leg((), (), 2, 0, 0)), begins=2)
    first = fit_behind(FittedRun(None, table), chain)
    assert first.fit is not None
    assert first.fit.starts == (6, 9)
    assert first.late == 1
    early = fit_behind(FittedRun(None, SlotTable(2, 20)), chain)
    assert early.fit is not None
    assert (early.fit.starts, early.late) == ((2, 5), 0)
    queued = fit_behind(first, Chain((Leg((1,), (), 25),)))
    assert (queued.fit, queued.table, queued.late) == (None, first.table, 1)


def test_a_plate_of_nobody_that_is_in_the_way_of_all_leaves_an_order_without_steps() -> None:
    lab = Driver(CELL)
    lab.scheduler = make_searching_scheduler()
    lab.stock("stack", 80)
    lab.stock("oven.nest", 1)
    for each in (TO_OVEN, FROM_LATHE):
        lab.submit(each)
    assert lab.pump() == []
    assert [order.steps for order in orders_of(lab).values()] == [()]
    (_, wait), *_ = lab.scheduler.list_waits(lab.state, lab.run("R1"), lab.now)
    assert "could not reach its end at present" in wait.reason.sentence


def searching_lab_with(*plans: Plan, pace: float = 1.0) -> Driver:
    lab = Driver(CELL, pace=pace)
    lab.scheduler = make_searching_scheduler()
    lab.stock("stack", 80)
    for each in plans:
        lab.submit(each)
    return lab


def test_in_an_empty_workcell_the_first_run_waits_until_the_search_is_over() -> None:
    lab = searching_lab_with(TO_LATHE, TO_OVEN, FROM_LATHE, TO_OVEN)
    orders = lab.scheduler.window_orders
    assert lab.pump() == []
    (_, wait), *_ = lab.scheduler.list_waits(lab.state, lab.run("R1"), lab.now)
    assert wait.reason.sentence.endswith("the lab searches for an order in which all work ends sooner")
    started: list[str] = []
    while not started:
        look = orders.find_next_look()
        assert look is not None
        lab.wait((look - lab.now) / 1e9)
        started = lab.pump()
    assert orders.tries >= ENOUGH_EACH * 4
    left = {step.run for step in orders_of(lab)["cell"].steps if step.step == 0 and step.start > lab.now}
    assert {name.partition("#")[0] for name in started} == {"R1", "R2", "R3", "R4"} - left
    go_on(lab)
    assert not lab.state.runs.active
    assert not lab.state.runs.queued
    assert "window.breached" not in lab.types()


def test_a_search_that_takes_long_holds_nobody_for_ever() -> None:
    lab = searching_lab_with(TO_LATHE, TO_OVEN, FROM_LATHE, TO_OVEN)
    assert lab.pump() == []
    lab.wait(LONGEST_SEARCH_NS / 1e9)
    assert lab.scheduler.window_orders.tries < ENOUGH_EACH * 4
    assert lab.pump() != []


def test_whoever_waits_for_the_search_is_not_late_where_lab_time_runs_fast() -> None:
    lab = searching_lab_with(TO_LATHE, TO_OVEN, FROM_LATHE, TO_OVEN, pace=100.0)
    assert lab.pump() == []
    started: list[str] = []
    while not started:
        lab.wait(0.1)  # ten seconds of the lab
        started = lab.pump()
        assert {step.run for step in orders_of(lab)["cell"].steps} == {"R1", "R2", "R3", "R4"}


def test_the_search_ends_with_the_runs_that_wait_for_it() -> None:
    lab = searching_lab_with(TO_LATHE, TO_OVEN)
    assert lab.pump() == []
    for run in ("R1", "R2"):
        lab.do(CancelRun(RunId(run), "ada"))
    lab.pump()
    assert not orders_of(lab)
    assert lab.scheduler.window_orders.find_next_look() is None
    lab.submit(TO_LATHE)
    assert lab.pump() == ["R3#0"]
