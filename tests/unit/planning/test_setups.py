"""Set-ups: a change costs time, is counted once, and is avoided where nobody has to wait for it for ever."""

from __future__ import annotations

import itertools
import random

import pytest

from labos.cli.explain import list_sentences
from labos.core.lengths import make_kinds
from labos.core.model import Plan, Window
from labos.core.setups import Setup, SetupChange
from labos.core.state import encode_picture
from labos.planning.certificate import certify, find_order
from labos.planning.forecast import find_setup_ns, find_usual_time
from labos.planning.lab_forecast import ForecastRequest, forecast_lab
from labos.planning.timetable import find_setups, make_timetable, with_setups
from labos.planning.waiting import PATIENCE
from labos.services.runs import RunHistory, StepHistory
from tests.support.bench import SECOND, Driver, module, plan, step, workcell

TEN_MIN = Setup("protocol", 600.0, (SetupChange("a", "b", 60.0),))


def bench(*names: str, setup: Setup | None = TEN_MIN) -> Driver:
    """Devices that have to be set up for a protocol; an eye that has not."""
    return Driver(workcell([*(module(name, setup=setup) for name in names or ("dev",)), module("eye")], []))


def does(protocol: str, on: str = "dev", duration_s: float = 300.0) -> Plan:
    one = step(on, key="do", args={"protocol": protocol}, duration_s=duration_s)
    return plan(one, name=f"do {protocol}")


def order(lab: Driver, rounds: int = 100) -> list[str]:
    """The protocols in the order in which they are started; each action ends before the next is started."""
    found: list[str] = []
    for _ in range(rounds):
        lab.pump()
        for action in list(lab.state.actions.open.values()):
            found.append(action.args["protocol"])
            lab.wait(300.0)
            lab.finish(action.id)
    return found


@pytest.mark.parametrize(
    ("before", "args", "cost_s"),
    [
        (None, {"protocol": "a"}, 600.0),
        ("a", {"protocol": "a"}, 0.0),
        ("a", {"protocol": "b"}, 60.0),
        ("b", {"protocol": "a"}, 600.0),
        ("a", {"speed": 3}, 0.0),
    ],
)
def test_what_a_change_costs(before: str | None, args: dict[str, object], cost_s: float) -> None:
    assert TEN_MIN.compute_cost_s(before, args) == cost_s


def test_a_module_is_set_up_for_its_last_action_until_one_does_not_succeed() -> None:
    lab = bench()
    run = lab.submit(does("a"))
    one = lab.state.runs.plan_of(lab.run(run)).steps[0]
    dev = lab.state.modules.by_name[one.module]
    assert (dev.set_up_for, find_setup_ns(lab.state, one), find_usual_time(lab.state, one)) == (
        None,
        600 * SECOND,
        900 * SECOND,
    )
    action = lab.start(run)
    assert (dev.set_up_for, dev.in_flight[action].setup_s, find_setup_ns(lab.state, one)) == ("a", 600.0, 0)
    lab.finish(action)
    assert dev.set_up_for == "a"
    lab.fail(lab.start(lab.submit(does("b"))), "none")
    assert dev.set_up_for is None


def test_of_one_user_those_go_first_for_which_nothing_has_to_be_changed() -> None:
    lab = bench()
    for protocol in "ababab":
        lab.submit(does(protocol))
    assert "".join(order(lab)) == "aaabbb"


def test_where_changes_cost_nothing_age_counts() -> None:
    lab = bench(setup=None)
    for protocol in "ababab":
        lab.submit(does(protocol))
    assert "".join(order(lab)) == "ababab"


def test_a_change_is_put_off_so_often_and_no_more() -> None:
    lab = bench()
    lab.submit(does("a"))
    lab.submit(does("b"))
    for _ in range(30):
        lab.submit(does("a"))
    assert order(lab).index("b") <= PATIENCE + 1


def test_nobody_elses_turn_is_put_off_to_save_a_change() -> None:
    """Bo has had less of the lab each time that ada would have had one more without a change."""
    lab = bench()
    for _ in range(4):
        lab.submit(does("a"), "ada")
        lab.submit(does("b"), "bo")
    assert "".join(order(lab)) == "abababab"


def test_inside_too_nothing_is_changed_where_that_can_be_avoided() -> None:
    lab = Driver(workcell([module("dev", setup=TEN_MIN), module("e"), module("f"), module("g")], []))
    lab.step(lab.submit(does("b")))

    def through(name: str, protocol: str) -> Plan:
        return plan(step(name, key="in"), *does(protocol).steps, name=f"{name} {protocol}")

    hold = lab.submit(does("b"))
    lab.pump()
    runs = [lab.submit(through(name, protocol)) for name, protocol in (("e", "a"), ("f", "c"), ("g", "b"))]
    lab.pump()
    for action in [a.id for a in lab.state.actions.open.values() if a.run != hold]:
        lab.finish(action)
    lab.finish(lab.list_flying()[0])
    assert lab.pump() == [f"{runs[2]}#1"]


def test_a_forecast_counts_each_change_once() -> None:
    lab = bench()
    for protocol in "abab":
        lab.submit(does(protocol))
    told = forecast_lab(ForecastRequest(encode_picture(lab.state), lab.now))
    ends = sorted((run.ends.expected_at - lab.now) // SECOND for run in told.runs if run.ends)
    assert ends == [900, 1200, 1560, 1860]  # a changes from nothing (600 s), b from a (60 s)


def test_a_forecast_knows_what_is_being_set_up() -> None:
    lab = bench()
    lab.start(lab.submit(does("a")))
    lab.wait(100.0)
    told = forecast_lab(ForecastRequest(encode_picture(lab.state), lab.now))
    assert told.runs[0].ends is not None
    assert told.runs[0].ends.expected_at == lab.now + 800 * SECOND


def test_what_is_learned_of_an_action_is_without_its_set_up() -> None:
    lab = bench()
    for protocol in "abaaab":
        run = lab.submit(does(protocol))
        one = lab.state.runs.plan_of(lab.run(run)).steps[0]
        lab.wait(10.0)
        action = lab.start(run)
        lab.wait(400.0 + lab.state.modules.by_name[one.module].in_flight[action].setup_s)
        lab.finish(action)
    times = lab.state.lengths.by_kind[make_kinds(does("a").steps[0])[0]]
    assert times.took == [400 * SECOND] * 2, "those for which nothing was changed"
    lab.step(lab.submit(does("b")))
    run = lab.submit(does("b"))
    assert find_usual_time(lab.state, lab.state.runs.plan_of(lab.run(run)).steps[0]) < 400 * SECOND
    run = lab.submit(does("a"))
    one = lab.state.runs.plan_of(lab.run(run)).steps[0]
    assert find_usual_time(lab.state, one) - find_setup_ns(lab.state, one) < 401 * SECOND
    assert find_setup_ns(lab.state, one) == 600 * SECOND


@pytest.mark.parametrize("seed", range(20))
def test_random_work_comes_to_its_end_with_set_ups(seed: int) -> None:
    """Users, priorities, due dates and protocols at random, on devices with and without set-ups."""
    rng = random.Random(f"setups/{seed}")
    lab = bench("p", "q")
    lab.careful = seed < 3
    for number in range(40):
        steps = [
            step(
                rng.choice(["p", "q", "eye"]),
                key=f"s{index}",
                args={"protocol": rng.choice("abc")},
                duration_s=rng.choice([60.0, 300.0]),
            )
            for index in range(rng.randint(1, 3))
        ]
        due_at = lab.now + rng.randint(-5, 50) * 600 * SECOND if rng.random() < 0.5 else 0
        made = plan(*steps, name=f"w{number}")
        lab.submit(made, rng.choice(["ada", "bo"]), priority=rng.choice([0, 0, 1]), due_at=due_at)
        if rng.random() < 0.5:
            lab.pump()
            lab.wait(rng.uniform(0, 300))
            for action in itertools.islice(lab.list_flying(), 1):
                lab.finish(action)
    assert lab.work(rng), lab.describe_stuck()
    assert lab.find_missed() == []
    assert not lab.rejected


def test_a_plan_counts_the_first_set_up_and_each_change() -> None:
    cell = workcell([module("dev", setup=TEN_MIN)], [])
    steps = [step("dev", key=f"s{n}", args={"protocol": p}, duration_s=300.0) for n, p in enumerate("aaba")]
    what = plan(*steps, name="four")
    setups = find_setups(what, cell, find_order(what))
    assert setups == {0: 600.0, 2: 60.0, 3: 600.0}
    assert make_timetable(with_setups(what, setups), cell).total_s == 4 * 300 + 1260


def test_a_certificate_knows_of_a_change() -> None:
    """The step between takes 330 s at the most, and 660 s more if the device has to be changed for it."""
    cell = workcell([module("dev", setup=Setup("protocol", 600.0)), module("eye")], [])

    def read_in_time(protocol: str) -> Plan:
        window = Window(0, within_s=400.0)
        between = step("dev", key="again", args={"protocol": protocol}, duration_s=300.0)
        first = step("dev", key="do", args={"protocol": "a"}, duration_s=300.0)
        return plan(first, between, step("eye", key="read", windows=(window,)), name="read")

    assert certify(read_in_time("a"), cell).is_kept
    [broken] = certify(read_in_time("b"), cell).windows
    assert broken.breaks_by_s == pytest.approx(590.0)


def test_explain_says_that_a_module_is_set_up_first() -> None:
    lab = bench()
    run = lab.submit(does("a"))
    lab.start(run)
    steps = [StepHistory(0, "do", "cell/dev", "act", "in flight")]
    story = RunHistory(run, "do a", "cell", "ada", "", 0, steps)
    assert "; dev is set up for it first, 10 min 00 s" in list_sentences(lab.state, story, lab.now)[0]
