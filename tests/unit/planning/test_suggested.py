"""A planner's advice: followed where it can be, and harmless where it is bad, late or malicious."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from itertools import count

import pytest

from labos.core.decide.nodes import ReportState
from labos.core.decide.runs import PauseRun
from labos.core.decide.suggestions import SuggestOrder
from labos.core.ids import ModuleName, RunId
from labos.core.model import Plan, Window
from labos.core.suggestions import MOST_STEPS, OrderSuggested, Suggested
from labos.planning.suggested import GRACE_S, MOST_S, Adviser
from labos.planning.window_order import OWN_WINDOWS
from tests.support.bench import Driver, full, module, move, plan, station, step, take, workcell

SECOND = 1_000_000_000

CELL = workcell(
    [module(name) for name in ("tower", "arm", "dev", "other", "clock", "watch")],
    [
        station("stack", "stack", 90),
        station("trash", "waste", 90),
        station("hall", "nest"),
        station("side", "nest"),
        station("dev.nest", "deck", claim=True),
        station("other.nest", "deck", claim=True),
    ],
)


TICKING = (full("clock"), full("watch"))


def visit(*modules: str, name: str = "visit", work_s: float = 100.0) -> Plan:
    """A plate goes from one module to the next, and to the waste."""
    steps = [step("tower", take("stack", "hall"), key="get", duration_s=10.0)]
    at = "hall"
    for one in modules:
        steps.append(step("arm", move(at, f"{one}.nest"), key=f"to {one}", duration_s=10.0))
        steps.append(step(one, key=f"work on {one}", duration_s=work_s))
        at = f"{one}.nest"
    steps.append(step("arm", move(at, "trash"), key="away", duration_s=10.0))
    return plan(*steps, name=name)


def dose_and_read() -> Plan:
    """The reader has to follow the end of the dispenser within two minutes."""
    read = step("other", key="read", duration_s=100.0, windows=(Window(1, 0.0, 120.0),))
    return plan(
        step("tower", take("stack", "dev.nest"), key="get", duration_s=10.0),
        step("dev", key="dose", duration_s=100.0),
        step("arm", move("dev.nest", "other.nest"), key="over", duration_s=10.0),
        read,
        step("arm", move("other.nest", "trash"), key="away", duration_s=10.0),
        name="dose and read",
    )


TICK = plan(step("clock", key="tick", duration_s=5000.0), name="tick")
OTHER_TICK = plan(step("watch", key="tick", duration_s=5000.0), name="other tick")


def make_lab(*plans: Plan) -> tuple[Driver, list[RunId]]:
    """A lab in which something moves for long, and runs that wait; nothing was planned yet."""
    lab = Driver(CELL)
    lab.stock("stack", 80)
    lab.submit(TICK)
    lab.pump()
    return lab, [lab.submit(each) for each in plans]


def suggest(lab: Driver, *steps: tuple[str, int, float], until_s: float = 3600.0) -> None:
    """Steps that should start so many seconds from now."""
    found = tuple(Suggested(RunId(run), step, lab.now + int(at * SECOND)) for run, step, at in steps)
    lab.do(SuggestOrder("cell", "planner", lab.now + int(until_s * SECOND), found, lab.state.position))


def why(lab: Driver, run: str, index: int = 0) -> str:
    waits = dict(lab.scheduler.list_waits(lab.state, lab.run(run), lab.now))
    return waits[index].reason.sentence if index in waits else ""


def test_the_suggested_order_is_followed_and_explained() -> None:
    lab, (first, second) = make_lab(visit("dev"), visit("other"))
    suggest(lab, (second, 0, 0.0), (first, 0, 20.0))
    assert lab.pump() == [f"{second}#0"]
    assert "planner suggests" not in why(lab, first), "the tower is busy anyway"
    lab, (first, second) = make_lab(visit("dev"), visit("other"))
    suggest(lab, (second, 0, 30.0), (first, 0, 40.0))
    lab.do(PauseRun(second, "ada"))
    assert lab.pump() == [f"{first}#0"], "who is paused keeps nobody waiting"


def test_a_step_waits_for_another_up_to_its_time_and_a_grace() -> None:
    lab, (first, second) = make_lab(visit("dev"), visit("dev", name="other"))
    suggest(lab, (second, 2, 50.0), (first, 0, 60.0), (first, 1, 70.0))
    assert lab.pump() == [f"{first}#0"], "they have no place in common before the device"
    lab.wait(10.0)
    lab.finish(next(a.id for a in lab.state.actions.open.values() if a.run == first))
    lab.pump()
    assert f"{second}" in why(lab, first, 1)
    assert "planner suggests" in why(lab, first, 1)
    lab.wait(40.0 + GRACE_S - 1)
    assert f"{first}#1" not in lab.pump()
    lab.wait(2.0)
    assert f"{first}#1" in lab.pump()


def test_where_nothing_moves_nobody_waits() -> None:
    lab = Driver(CELL)
    lab.stock("stack", 80)
    first, second = lab.submit(visit("dev")), lab.submit(visit("dev", name="other"))
    suggest(lab, (second, 0, 30.0), (first, 0, 40.0))
    assert lab.pump() == [f"{second}#0"], "it is first by the order, and the other waits for it"
    assert lab.find_missed() == []


def test_a_higher_priority_is_not_held_up() -> None:
    lab, (low,) = make_lab(visit("dev"))
    high = lab.submit(visit("dev"), priority=5)
    suggest(lab, (low, 0, 30.0), (high, 0, 40.0))
    assert lab.pump()[0] == f"{high}#0"


def test_an_order_that_is_over_counts_no_more() -> None:
    lab, (first, second) = make_lab(visit("dev"), visit("dev", name="other"))
    suggest(lab, (second, 0, 900.0), (first, 0, 1000.0), until_s=100.0)
    assert lab.pump() == [f"{second}#0"]
    assert why(lab, first) != ""
    lab, (first, second) = make_lab(visit("dev"), visit("dev", name="other"))
    suggest(lab, (second, 0, 900.0), (first, 0, 1000.0), until_s=1.0)
    lab.wait(2.0)
    assert lab.pump() == [f"{first}#0"]


def test_a_line_names_each_run_once_and_only_those_that_have_not_ended() -> None:
    lab, (first, second) = make_lab(visit("dev"), visit("other"))
    until = lab.now + 60 * SECOND
    (found,) = lab.do(SuggestOrder("cell", "p", until, (), line=(second, RunId("R999"), first, second)))
    assert isinstance(found, OrderSuggested)
    assert found.line == (second, first)
    assert lab.state.suggestions.find_line("cell", lab.now) == (second, first)
    assert lab.state.suggestions.find("cell", lab.now) is None, "it says nothing about single steps"
    assert lab.state.suggestions.find_line("cell", until) == ()


def refusal(lab: Driver, steps: Sequence[Suggested], cell: str = "cell", position: int = 0) -> str:
    command = SuggestOrder(cell, "planner", lab.now, tuple(steps), position)
    return lab.reject(command).code


def test_what_is_no_order_is_refused() -> None:
    lab, (run,) = make_lab(visit("dev"))
    assert refusal(lab, [], cell="elsewhere") == "not_found"
    assert refusal(lab, [Suggested(run, 99, 0)]) == "no_step"
    assert refusal(lab, [Suggested(run, -1, 0)]) == "no_step"
    assert refusal(lab, [Suggested(run, 0, 0)] * (MOST_STEPS + 1)) == "too_many"
    assert refusal(lab, [], position=10**6) == "ahead"
    both = SuggestOrder("cell", "planner", lab.now, (Suggested(run, 0, 0),), line=(run,))
    assert lab.reject(both).code == "two_orders"
    too_many = SuggestOrder("cell", "planner", lab.now, (), line=(run,) * (MOST_STEPS + 1))
    assert lab.reject(too_many).code == "too_many"
    assert lab.do(SuggestOrder("cell", "planner", 0, (Suggested(RunId("R999"), 0, 0),)))[0].steps == ()  # type: ignore[attr-defined]


@pytest.mark.parametrize("seed", range(40))
def test_bad_advice_stops_nobody(seed: int) -> None:
    """Random orders, past and future, of runs that exist or not, again and again: every run comes to its end,
    and nothing that could start is left out."""
    rng = random.Random(f"advice/{seed}")
    lab = Driver(CELL)
    lab.stock("stack", 80)
    ways = [("dev",), ("other",), ("dev", "other"), ("other", "dev")]
    for number in range(rng.randint(2, 9)):
        clocked = rng.random() < 0.3
        lab.submit(
            dose_and_read() if clocked else visit(*rng.choice(ways), name=f"w{number}"),
            user=rng.choice(["ada", "bo"]),
            priority=rng.choice([0, 0, 0, 3]),
        )

    def pump() -> None:
        if rng.random() < 0.4:
            runs = [*lab.state.runs.active.values(), *lab.state.runs.queued.values()]
            steps = []
            for _ in range(rng.randint(0, 30)):
                run = rng.choice(runs) if runs else None
                count = len(lab.state.runs.plan_of(run).steps) if run else 1
                at = lab.now + rng.randint(-200, 4000) * SECOND
                steps.append(Suggested(run.id if run else RunId("R9"), rng.randrange(count), max(0, at)))
            until = lab.now + rng.randint(-10, 10_000) * SECOND
            lab.do(SuggestOrder("cell", "planner", until, tuple(steps), rng.randint(0, lab.state.position)))
        lab.pump()
        assert lab.find_missed() == []

    assert lab.work(rng, pump), lab.describe_stuck()
    lab.check_log()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["stops", "renews", "turns", "strangers", "stale", "floods"])
def test_no_planner_holds_a_lab_up(kind: str) -> None:
    """Something moves all the time, one run cannot go on as its module is broken, and the planner does its
    worst. The others come to their ends, none of their steps later than the longest time for advice."""
    lab = Driver(CELL)
    lab.stock("stack", 80)
    broken = lab.submit(visit("other"))
    runs = [lab.submit(visit("dev", name=f"n{number}")) for number in range(3)]
    lab.do(ReportState(ModuleName(full("other")), "ERROR", "jammed"))
    everybody = [broken, *runs]

    def orders() -> Iterator[list[tuple[str, int, float]]]:
        match kind:
            case "stops":  # for ever, once
                yield [(broken, step, 10.0**8) for step in range(4)]
                while True:
                    yield []
            case "renews":  # what cannot start is always about to start
                while True:
                    yield [(broken, step, 30.0) for step in range(4)]
            case "turns":  # now one goes first, now another; later steps before earlier ones
                for number in count():
                    turned = everybody[number % 4 :] + everybody[: number % 4]
                    yield [(r, s, 20.0 * i + 5 * (4 - s)) for i, r in enumerate(turned) for s in range(4)]
            case "strangers":
                while True:
                    yield [("R99", 0, 0.0), *((run, 3, 10.0**6) for run in everybody)]
            case "stale":  # of times that have long passed
                while True:
                    yield [(run, step, -(10.0**6)) for run in everybody for step in range(4)]
            case _:
                while True:
                    yield [(broken, number % 4, 60.0 + number) for number in range(100)]

    begun = lab.now
    for number, steps in enumerate(orders()):
        for _ in range(3 if kind == "floods" else 1 if steps else 0):
            found = [(run, step, max(at, -lab.now / SECOND)) for run, step, at in steps]
            suggest(lab, *found, until_s=10.0**9)
        lab.submit(OTHER_TICK if number % 2 else TICK)  # before the one that is under way has ended
        lab.pump()
        if all(lab.state.runs.get(run) is None for run in runs):
            break
        lab.wait(500.0)
        ticking = [a.id for a in lab.state.actions.open.values() if a.module in TICKING]
        for action in [*ticking[:-1], *(each for each in lab.list_flying() if each not in ticking)]:
            lab.finish(action)
        assert (lab.now - begun) / SECOND < 3 * 4 * (MOST_S + 1000.0), lab.describe_stuck()
    assert lab.state.runs.get(broken) is not None
    lab.check_log()


def test_a_step_that_starts_a_clock_waits_for_its_own_time() -> None:
    lab, (run,) = make_lab(dose_and_read())
    suggest(lab, (run, 0, 0.0), (run, 1, 50.0))
    assert lab.pump() == [f"{run}#0"]
    lab.wait(10.0)
    lab.finish(next(a.id for a in lab.state.actions.open.values() if a.run == run))
    assert lab.pump() == []
    assert "the planner suggests that the clock of 'dose' starts later" in why(lab, run, 1)
    lab.wait(40.0)
    assert lab.pump() == [f"{run}#1"]


def dose_read_and_watch() -> Plan:
    """As before, and the end of the reader starts another clock."""
    before = dose_and_read()
    watch = step("watch", key="look", duration_s=10.0, windows=(Window(3, 0.0, 600.0),))
    return plan(*before.steps[:4], watch, before.steps[4], name="dose, read and look")


def go_on(lab: Driver, run: str, seconds: float) -> list[str]:
    """The step of a run that is in flight ends after so long; returns what starts then."""
    lab.wait(seconds)
    lab.finish(next(a.id for a in lab.state.actions.open.values() if a.run == run))
    return lab.pump()


def test_a_step_waits_for_its_time_only_while_its_running_clock_allows_it() -> None:
    lab, (run,) = make_lab(dose_read_and_watch())
    suggest(lab, *((run, i, at) for i, at in enumerate((0.0, 10.0, 210.0, 220.0, 320.0))))
    lab.pump()
    assert go_on(lab, run, 10.0) == [f"{run}#1"]
    assert go_on(lab, run, 50.0) == [f"{run}#2"], "dose has ended 50 s before its time"
    assert go_on(lab, run, 10.0) == []
    assert "the planner suggests that the clock of 'read' starts later" in why(lab, run, 3)
    assert lab.scheduler.find_next_wake() == lab.now + 110 * SECOND
    lab.wait(110.0)
    assert lab.pump() == [f"{run}#3"], "its window of 120 s is kept"
    assert lab.find_missed() == []


def test_a_step_lets_another_go_first_only_while_its_running_clock_allows_it() -> None:
    lab, (run, other) = make_lab(dose_and_read(), visit("dev", name="other"))
    suggest(lab, (run, 0, 0.0), (run, 1, 10.0), (other, 1, 170.0), (run, 2, 180.0), (run, 3, 190.0))
    lab.pump()
    go_on(lab, run, 10.0)
    assert f"{run}#2" not in go_on(lab, run, 100.0)
    assert "planner suggests" in why(lab, run, 2)
    lab.wait(109.0)
    assert f"{run}#2" not in lab.pump()
    lab.wait(1.0)
    assert f"{run}#2" in lab.pump(), "it takes 10 s, and has to be over 120 s after the clock began"
    assert lab.find_missed() == []


def test_a_clock_of_a_higher_priority_does_not_wait_for_its_time() -> None:
    lab, (low,) = make_lab(visit("other"))
    high = lab.submit(dose_and_read(), priority=5)
    suggest(lab, (high, 0, 0.0), (high, 1, 500.0), (low, 0, 600.0))
    assert lab.pump() == [f"{high}#0"]
    lab.wait(10.0)
    lab.finish(next(a.id for a in lab.state.actions.open.values() if a.run == high))
    assert f"{high}#1" in lab.pump()


def test_where_nothing_moves_no_clock_waits_for_its_time() -> None:
    lab = Driver(CELL)
    lab.stock("stack", 80)
    run = lab.submit(dose_and_read())
    suggest(lab, (run, 1, 3000.0))
    assert lab.pump() == [f"{run}#0"]
    lab.finish(next(a.id for a in lab.state.actions.open.values() if a.run == run))
    assert lab.pump() == [f"{run}#1"]


def test_an_order_keeps_out_no_run_that_it_does_not_name_and_that_is_gone_in_time() -> None:
    for start_s, comes_in in ((600.0, True), (15.0, False)):
        lab, (named, stranger) = make_lab(visit("dev"), visit("other", name="stranger"))
        outside = Suggested(named, 0, lab.now + int(start_s * SECOND), outside=True)
        lab.do(SuggestOrder("cell", "planner", lab.now + 3600 * SECOND, (outside,)))
        assert lab.pump() == ([f"{stranger}#0"] if comes_in else []), "the hall has to be free again in time"


def test_of_equal_runs_the_older_one_does_not_wait_behind_one_that_waits_outside() -> None:
    lab, (older, younger) = make_lab(visit("dev"), visit("dev"))
    outside = Suggested(younger, 0, lab.now + 600 * SECOND, outside=True)
    lab.do(SuggestOrder("cell", "planner", lab.now + 3600 * SECOND, (outside,)))
    assert lab.pump() == [f"{older}#0"]


def test_what_an_order_of_the_labs_own_does_not_name_comes_after_it() -> None:
    lab, (named, stranger) = make_lab(visit("dev"), visit("other", name="stranger"))
    steps, until = (Suggested(named, 0, lab.now + 600 * SECOND),), lab.now + 3600 * SECOND
    for by, waits in (("planner", False), (OWN_WINDOWS, True)):
        adviser = Adviser(None, {"cell": OrderSuggested("cell", by, until, steps)})
        assert bool(adviser.check_start(lab.state, lab.run(stranger), 0, lab.now)) is waits


@pytest.mark.parametrize("all_is_kept", [True, False])
def test_a_running_clock_waits_for_an_order_of_the_labs_own_only_if_it_keeps_all_windows(
    all_is_kept: bool,
) -> None:
    lab, (clocked, other) = make_lab(dose_and_read(), visit("other"))
    for index in range(2):
        lab.finish(lab.start(clocked, index))
    steps = tuple(
        Suggested(RunId(run), i, lab.now + at * SECOND) for run, i, at in ((other, 1, 10), (clocked, 2, 20))
    )
    adviser = Adviser(None, {"cell": OrderSuggested("cell", OWN_WINDOWS, lab.now + 3600 * SECOND, steps)})
    wait = adviser.check_start(lab.state, lab.run(clocked), 2, lab.now, lambda: all_is_kept)
    assert bool(wait) is all_is_kept, "the other one should have the arm first"
    too_late = lab.now + 110 * SECOND
    assert adviser.check_start(lab.state, lab.run(clocked), 2, too_late, lambda: True) is None


def test_a_run_waits_outside_until_its_time_and_never_for_ever() -> None:
    lab, (run,) = make_lab(visit("dev"))
    outside = Suggested(run, 0, lab.now + 600 * SECOND, outside=True)
    lab.do(SuggestOrder("cell", "planner", lab.now + 3600 * SECOND, (outside,)))
    assert lab.pump() == []
    assert "starts later" in why(lab, run)
    lab.wait(599.0)
    assert lab.pump() == []
    lab.wait(1.0)
    assert lab.pump() == [f"{run}#0"]
    lab, (run,) = make_lab(visit("dev"))
    for _ in range(int(MOST_S / 500) + 1):  # a planner that puts it off again and again
        outside = Suggested(run, 0, lab.now + 600 * SECOND, outside=True)
        lab.do(SuggestOrder("cell", "planner", lab.now + 10**15, (outside,)))
        assert lab.pump() == []
        lab.wait(500.0)
    outside = Suggested(run, 0, lab.now + 600 * SECOND, outside=True)
    lab.do(SuggestOrder("cell", "planner", lab.now + 10**15, (outside,)))
    assert lab.pump() == [f"{run}#0"]


def test_an_order_that_was_withdrawn_or_is_over_is_none() -> None:
    lab, (run,) = make_lab(visit("dev"))
    suggest(lab, (run, 0, 600.0), until_s=700.0)
    assert lab.state.suggestions.find("cell", lab.now) is not None
    assert lab.state.suggestions.find("cell", lab.now + 701 * SECOND) is None
    suggest(lab)
    assert lab.state.suggestions.find("cell", lab.now) is None
