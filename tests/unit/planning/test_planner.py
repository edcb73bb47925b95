"""A planner suggests only what a rehearsal of the lab finds better than nothing. No OR-tools are needed."""

from __future__ import annotations

import random
from collections.abc import Mapping

import pytest
from msgspec.structs import replace

from labos.core.decide.bookings import MakeBooking, NewTerms
from labos.core.decide.suggestions import SuggestOrder
from labos.core.ids import RunId
from labos.core.lengths import Times, make_kinds
from labos.core.model import Plan, Window
from labos.core.runs import RunState
from labos.core.shares import Usage
from labos.core.suggestions import Suggested
from labos.planner.overtakings import Overtakings
from labos.planner.planner import Planner
from labos.planner.problem import (
    MOST_WINDOWED,
    SchedulingProblem,
    Task,
    TimeLag,
    add_next,
    choose_runs,
    problem_of,
)
from labos.planner.rehearsal import OrderRehearsal, Way
from labos.planner.solve import Schedule, solve
from labos.planner.watch import list_waiting
from labos.planning.virtual import Play
from labos.planning.waiting import PATIENCE
from tests.support.bench import SECOND, Driver, full, plan, step
from tests.unit.planning.test_pilot import lab_with, way
from tests.unit.planning.test_suggested import CELL, dose_and_read, make_lab, suggest, visit
from tests.unit.planning.test_window_order import hurried


def cut(name: str) -> Plan:
    return plan(step("dev", key="a", duration_s=600.0), step("dev", key="b", duration_s=600.0), name=name)


def both(name: str) -> Plan:
    return plan(step("dev", key="a", duration_s=600.0), step("other", key="b", duration_s=600.0), name=name)


def waits() -> tuple[Driver, RunId, RunId]:
    """In the order of the lab `other` waits for `dev` twice: 2,400 s; the other way round 1,800 s. The lab
    does not find that out by itself: the second user has had more lab time."""
    lab = Driver(CELL)
    lab.state.shares.usage["bob"] = Usage(600.0 * SECOND, lab.now)
    first, second = lab.submit(cut("cut"), user="ada"), lab.submit(both("both"), user="bob")
    return lab, first, second


class Fixed:
    """A search that finds that these runs should go in this order, a second apart."""

    def __init__(self, *order: RunId) -> None:
        self.order = order

    def __call__(self, problem: SchedulingProblem, seconds: float, hint: Mapping[int, float]) -> Schedule:
        starts = [100.0 * self.order.index(task.run) + task.step for task in problem.tasks]
        return Schedule(tuple(starts), 0.0, False)


def chosen(lab: Driver) -> list[RunState]:
    return choose_runs(lab.state, "cell", list_waiting(lab.state, "cell"))


def find_order(planner: Planner, lab: Driver) -> SuggestOrder | None:
    return planner.suggest(lab.state, "cell", list_waiting(lab.state, "cell"), lab.now)


def test_a_better_order_is_suggested() -> None:
    lab, first, second = waits()
    order = find_order(Planner(solver=Fixed(second, first)), lab)
    assert order is not None
    assert order.steps[0].run == second


def test_an_order_that_is_no_better_is_not_suggested() -> None:
    lab, first, second = waits()
    assert find_order(Planner(solver=Fixed(first, second)), lab) is None


def test_an_order_that_came_out_worse_is_taken_back() -> None:
    lab, first, second = waits()
    lab.do(find_order(Planner(solver=Fixed(second, first)), lab) or pytest.fail("it is better"))
    assert find_order(Planner(solver=Fixed(second, first)), lab) is None, (
        "as good as what was suggested before"
    )
    lab = Driver(CELL)
    lab.state.shares.usage["ada"] = Usage(600.0 * SECOND, lab.now)
    second, first = lab.submit(both("both"), user="bob"), lab.submit(cut("cut"), user="ada")
    suggest(lab, (first, 0, 0.0), (first, 1, 1.0), (second, 0, 2.0))
    order = find_order(Planner(solver=Fixed(first, second)), lab)
    assert order is not None
    assert order.steps == ()


def test_a_step_takes_as_long_with_an_order_as_without() -> None:
    lab = Driver(CELL)
    lab.stock("stack", 80)
    runs = [lab.submit(dose_and_read()) for _ in range(6)]
    rehearsal = OrderRehearsal(lab.state, "cell", lab.now, 0.5, chosen(lab))
    steps = [Suggested(run, 0, lab.now + 300 * SECOND * n) for n, run in enumerate(reversed(runs))]
    order = SuggestOrder("cell", "planner", lab.now + 3600 * SECOND, tuple(steps))
    ways = [rehearsal.go(None), rehearsal.go(order)]
    rehearsal.is_as_good(ways[1], ways[0])
    played = zip(*(way.plays for way in ways), strict=True)
    for number, plays in enumerate(played):
        took = [{run: play.ends[run] - play.begun[run, 4] for run in runs} for play in plays]
        assert took[0] == took[1]
        assert len(set(took[0].values())) == (len(runs) if number else 1), "drawn durations differ"
    assert len(ways[0].plays) == 4


def make_way(run: RunId, end: int, *missed: int) -> Way:
    """A way that was played with durations of the plan first, and then with drawn ones."""
    return Way(None, [Play(ends={run: end}, missed=times) for times in missed])


def test_one_play_with_drawn_durations_does_not_decide() -> None:
    lab = Driver(CELL)
    lab.stock("stack", 80)
    run, _ = lab.submit(dose_and_read()), lab.submit(dose_and_read())
    rehearsal = OrderRehearsal(lab.state, "cell", lab.now, 0.5, chosen(lab))
    late, soon = lab.now + 2000 * SECOND, lab.now + 1500 * SECOND
    before = make_way(run, late, 0, 0, 2, 1)
    assert rehearsal.is_better(make_way(run, soon, 0, 1, 0, 1), before)
    assert rehearsal.is_better(make_way(run, soon, 0, 1, 1, 1), before), (
        "as many are missed, and all ends sooner"
    )
    assert not rehearsal.is_better(make_way(run, soon, 0, 2, 1, 1), before)
    assert not rehearsal.is_better(make_way(run, soon, 1, 0, 0, 0), before), "with the durations of the plan"


def test_nothing_is_changed_by_looking() -> None:
    lab, first, second = waits()
    before = lab.state.position
    find_order(Planner(solver=Fixed(second, first)), lab)
    assert lab.state.position == before
    assert set(lab.state.runs.queued) == {first, second}
    assert lab.state.suggestions.orders == {}


@pytest.mark.parametrize(("level", "took_s"), [(0.0, 60.0), (0.5, 80.0), (1.0, 100.0)])
def test_durations_are_those_of_a_quantile_of_the_last_times(level: float, took_s: float) -> None:
    lab, (run, _) = make_lab(visit("dev"), visit("other"))
    work = lab.state.runs.plan_of(lab.run(run)).steps[2]
    times = lab.state.lengths.by_kind[make_kinds(work)[0]] = Times()
    for seconds in (80, 60, 100):
        times.took.append(int(seconds * 1e9))
    problem = problem_of(lab.state, chosen(lab), lab.now, level)
    found = {(task.run, task.step): task.duration_s for task in problem.tasks}
    assert found[run, 2] == took_s
    assert found[run, 0] == pytest.approx(10.0 * (0.9 + 0.2 * level)), "of which nothing is known"


def test_nothing_is_planned_for_when_a_module_is_booked_for_others() -> None:
    pytest.importorskip("ortools")
    lab, first, second = waits()
    begins, ends = lab.now + 700 * SECOND, lab.now + 1500 * SECOND
    lab.do(MakeBooking("cell/dev", NewTerms(begins=begins, ends=ends, maintenance=True), "op", lab.now))
    problem = problem_of(lab.state, chosen(lab), lab.now)
    shut = {(task.run, task.step): task.shut for task in problem.tasks}
    assert shut[first, 0] == ((700.0, 1500.0),)
    assert shut[second, 1] == (), "the other module is free"
    found = solve(problem, 5.0)
    assert found is not None
    for task, start in zip(problem.tasks, found.starts_s, strict=True):
        assert not task.shut or start + task.duration_s <= 700.0 or start >= 1500.0
    assert found.makespan_s == 2700.0
    order = find_order(Planner(), lab)
    assert order is None or order.steps[0].run == second


def test_a_search_lets_nobody_be_overtakings_more_often_than_the_lab_allows() -> None:
    """One long run and twelve short ones: each ends sooner if the long one is last, and it is not."""
    pytest.importorskip("ortools")
    lab = Driver(CELL)
    long = lab.submit(plan(step("dev", key="a", duration_s=6000.0), name="long"))
    for number in range(12):
        lab.submit(plan(step("dev", key="a", duration_s=60.0), name=f"short {number}"))
    problem = problem_of(lab.state, chosen(lab), lab.now)
    found = solve(problem, 5.0)
    assert found is not None
    starts = {task.run: start for task, start in zip(problem.tasks, found.starts_s, strict=True)}
    assert sum(start < starts[long] for start in starts.values()) == PATIENCE
    found = solve(replace(problem, overtaken=(5, *[0] * 12)), 5.0)
    assert found is not None
    starts = {task.run: start for task, start in zip(problem.tasks, found.starts_s, strict=True)}
    assert sum(start < starts[long] for start in starts.values()) == PATIENCE - 5, (
        "five went before it already"
    )


def test_a_planner_counts_who_went_before_an_older_run() -> None:
    lab, counts = Driver(CELL), Overtakings()

    def count() -> dict[RunId, int]:
        return counts.count(lab.state, "cell", list_waiting(lab.state, "cell"))

    elder = lab.submit(cut("elder"))
    other = lab.submit(plan(step("other", key="a", duration_s=60.0), name="needs another module"))
    younger = lab.submit(cut("younger"))
    last = lab.submit(cut("last"))
    assert count() == dict.fromkeys([elder, other, younger, last], 0)
    lab.start(younger)
    assert count() == {elder: 1, other: 0, last: 0}
    assert count() == {elder: 1, other: 0, last: 0}, "each counts once"


def test_a_window_that_only_rounding_would_miss_does_not_end_a_search() -> None:
    """Times are whole seconds in a search: here two steps of 10.4 s take 22 s, of which 21 are allowed."""
    pytest.importorskip("ortools")
    run = RunId("run")
    steps = (
        Task(run, 0, 10.4, ("a",), ()),
        Task(run, 1, 10.4, ("b",), (0,)),
        Task(run, 2, 10.4, ("c",), (1,)),
        Task(run, 3, 10.4, ("d",), (2,), (TimeLag(0, 0.0, 0.0, 21.0),)),
    )
    problem = SchedulingProblem(steps, (), {}, (), ((3,),), (False,))
    found = solve(problem, 1.0, {number: 10.4 * number for number in range(4)})
    assert found is not None
    assert found.starts_s == (0.0, 11.0, 22.0, 33.0)


def make_hard_problem() -> SchedulingProblem:
    """Ten runs over three modules, each in its own order. Each step has to start within an hour after the one
    before."""
    tasks: list[Task] = []
    for run in range(10):
        for place in range(3):
            number, module = len(tasks), f"m{(run + place * (1 + run % 2)) % 3}"
            seconds = 60.0 * (1 + (run * 7 + place * 5) % 9)
            after = (number - 1,) if place else ()
            lags = tuple(TimeLag(before, 0.0, 0.0, 3600.0) for before in after)
            tasks.append(Task(RunId(f"R{run}"), place, seconds, (module,), after, lags))
    ends = tuple((number,) for number in range(2, len(tasks), 3))
    return SchedulingProblem(tuple(tasks), (), {}, (), ends, (False,) * 10)


def test_a_search_that_begins_at_a_bad_order_finds_one_that_is_far_from_it() -> None:
    """The known schedule carries out one task after the other."""
    pytest.importorskip("ortools")
    problem = make_hard_problem()
    in_line, at = {}, 0.0
    for number, task in enumerate(problem.tasks):
        in_line[number] = at
        at += task.duration_s
    anew = solve(problem, 0.002, counted=True)
    found = solve(problem, 0.002, in_line, counted=True)
    assert anew is not None
    assert found is not None
    assert found.makespan_s <= anew.makespan_s < at


def test_a_search_is_never_worse_than_the_schedule_at_which_it_begins() -> None:
    pytest.importorskip("ortools")
    problem = make_hard_problem()
    best = solve(problem, 0.1, counted=True)
    assert best is not None
    again = solve(problem, 0.001, dict(enumerate(best.starts_s)), counted=True)
    assert again is not None
    assert again.makespan_s <= best.makespan_s


def test_a_run_that_would_stand_in_the_way_waits_outside() -> None:
    """The long run has `other`, the next one waits for it on `dev`, and the third would wait in the hall."""
    lab = Driver(CELL)
    lab.stock("stack", 80)
    lab.submit(visit("other", work_s=3000.0))
    second = lab.submit(visit("dev", "other", name="next"))
    while f"{second}#2" not in lab.pump():
        lab.wait(10.0)
        for action in [a.id for a in lab.state.actions.open.values() if a.module != full("other")]:
            lab.finish(action)
    third = lab.submit(visit("dev", name="third"))
    order = find_order(Planner(solver=lambda *_: None), lab)
    assert order is not None
    assert [(one.run, one.step, one.outside) for one in order.steps] == [(third, 0, True)]
    assert (order.steps[0].start - lab.now) / SECOND == pytest.approx(0.9 * 3000.0, rel=0.05)
    lab.do(order)
    assert find_order(Planner(solver=lambda *_: None), lab) is None, "it waits already"
    assert find_order(Planner(solver=lambda *_: None, exact=True), lab) is not None, "nothing is in its way"


def test_an_order_for_a_part_of_the_runs_is_rehearsed_with_the_next_ones() -> None:
    lab = Driver(CELL)
    window = (Window(0, 0.0, 600.0),)
    steps = step("dev", key="a", duration_s=60.0), step("other", key="b", duration_s=60.0)
    for number in range(MOST_WINDOWED + 5):
        lab.submit(plan(steps[0], replace(steps[1], windows=window), name=f"run {number}"))
    planned = chosen(lab)
    rehearsed = add_next(planned, list_waiting(lab.state, "cell"))
    assert len(planned) == MOST_WINDOWED
    assert rehearsed[:MOST_WINDOWED] == planned
    assert len({run.id for run in rehearsed}) == MOST_WINDOWED + 5


def test_a_rehearsal_protects_who_was_overtaken_before() -> None:
    """The order lets the younger run go first: after eight of these, the lab would not follow it."""
    lab, elder, younger = waits()
    order = find_order(Planner(solver=Fixed(younger, elder)), lab)
    assert order is not None

    def find_first(overtaken: dict[RunId, int]) -> RunId:
        rehearsal = OrderRehearsal(lab.state, "cell", lab.now, 0.5, chosen(lab), overtaken=overtaken)
        return min((elder, younger), key=rehearsal.go(order).plays[0].starts.__getitem__)

    assert find_first({elder: PATIENCE - 1}) == younger
    assert find_first({elder: PATIENCE}) == elder


@pytest.mark.slow
def test_where_clocks_run_a_planner_tries_more_orders_than_the_lab_has_time_for() -> None:
    draws = random.Random("more orders")
    ways = []
    for number in range(10):
        stops = [(name, draws.choice([30.0, 120.0, 240.0])) for name in ("mill", "lathe", "oven")]
        draws.shuffle(stops)
        ways.append(hurried(way(f"way {number}", *stops)))
    lab = lab_with(*ways)
    waiting = list_waiting(lab.state, "cell")
    order = find_order(Planner(seconds=0.1, solver=lambda *_: None, exact=True), lab)
    assert order is not None
    rehearsal = OrderRehearsal(lab.state, "cell", lab.now, 0.5, waiting, drawn=0)
    with_it, without = (rehearsal.go(each).plays[0] for each in (order, None))
    assert (with_it.missed, without.missed) == (0, 0)
    assert max(with_it.ends.values()) < max(without.ends.values())
