"""Windows that can be kept are kept where durations are as declared: short ones, several in a row, side by
side, and across the runs of an experiment. And whoever waits for the sake of a window goes on."""

from __future__ import annotations

import pytest

from labos.core.decide.runs import PauseRun, ResumeRun
from labos.core.ids import ActionId
from labos.core.model import Plan, Window
from tests.benchmarks.windows import Count, count
from tests.simulation.clocked import Instance, judge, one_by_one, run_planned
from tests.support.bench import SECOND, Driver, hold, move, plan, small, step, take

HARD = (72, 82, 83, 86, 95, 117, 168, 208, 243, 302, 402, 420, 646, 868, 910, 937)
"""Seeds in which windows were lost for reasons of their own: doors, swaps of places, waits that are as long
as their windows, decks that somebody leaves much later, labware of an experiment."""


def describe_count(found: Count) -> str:
    return (
        f"{found.instances} labs, {found.windows} windows: {found.breached} breached, "
        f"{found.avoidable} of them avoidable in {found.hit} labs"
    )


@pytest.mark.slow
def test_no_window_is_breached_that_could_be_kept() -> None:
    found = count(range(25))
    print(describe_count(found))
    assert found.windows > 120
    assert found.avoidable == 0, describe_count(found)


@pytest.mark.parametrize("seed", HARD)
def test_no_window_is_breached_that_could_be_kept_where_it_is_hard(seed: int) -> None:
    assert judge(seed).avoidable == {}


def test_a_lab_that_cannot_keep_all_windows_comes_to_its_end_all_the_same() -> None:
    """Some runs have windows that nobody can keep: ``planned`` asserts that everybody ends."""
    hopeless = 0
    for seed in range(50, 65):
        hopeless += bool(one_by_one(Instance(seed)).find_breached())
        run_planned(Instance(seed))
    assert hopeless > 0


@pytest.mark.slow
def test_durations_that_stray_keep_nobody_from_the_end() -> None:
    for seed in range(20):
        run_planned(Instance(seed), stray=0.3)


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_a_thousand_labs_with_clocks() -> None:
    found = count(range(1000))
    print(describe_count(found))
    assert found.avoidable == 0, describe_count(found)


# -- one thing at a time -----------------------------------------------------------------------------


def make_dosed(takes_s: float, within_s: float) -> Plan:
    """A step that is followed on ``cam`` within a time that is short beside its own."""
    window = Window(0, 0.0, within_s)
    dose = step("dev", key="dose", duration_s=takes_s)
    return plan(dose, step("cam", key="read", duration_s=10.0, windows=(window,)), name="dosed")


def why(lab: Driver, run: str, index: int = 0) -> str:
    wait = lab.scheduler.check_start(lab.state, lab.run(run), index, lab.now, only_asking=True)
    return "" if wait is None else wait.reason.sentence


@pytest.mark.parametrize("within_s", [1.0, 20.0, 179.0])
def test_a_window_that_is_short_beside_its_anchor_is_kept(within_s: float) -> None:
    """Its reader is wanted for long while the dose still takes 300 s."""
    lab = small()
    run = lab.submit(make_dosed(900.0, within_s))
    assert lab.pump() == [f"{run}#0"]
    lab.wait(600.0)
    long = lab.submit(plan(step("cam", key="film", duration_s=300.0 + within_s + 1.0), name="film"))
    assert lab.pump() == []
    assert why(lab, long) in (
        f"starting 'film' now would make run {run} late for 'read'",
        f"cam is reserved for run {run}, whose step 'read' has to start in time",
    )
    lab.wait(300.0)
    lab.finish(lab.list_flying()[0])
    assert lab.pump() == [f"{run}#1"]
    lab.wait(10.0)
    lab.finish(lab.list_flying()[0])
    assert lab.pump() == [f"{long}#0"]


def test_a_clock_waits_for_what_follows_at_the_end_of_a_chain() -> None:
    """Three windows in a row; what is in flight leaves no time for the last one."""
    lab = small()
    lab.start(lab.submit(plan(step("arm2", duration_s=500.0), name="busy")))
    chain = plan(
        step("dev", key="one", duration_s=10.0),
        step("arm", key="two", duration_s=10.0, windows=(Window(0, 0.0, 5.0),)),
        step("cam", key="three", duration_s=10.0, windows=(Window(1, 0.0, 5.0),)),
        step("arm2", key="four", duration_s=10.0, windows=(Window(2, 0.0, 5.0),)),
        name="chain",
    )
    run = lab.submit(chain)
    assert lab.pump() == []
    assert why(lab, run) == "if 'one' started now, 'four' could not start in time"
    assert lab.scheduler.find_next_deadline(lab.state) is not None
    order = live(lab)
    assert order == [f"{run}#{index}" for index in range(4)]
    assert "window.breached" not in lab.types()


def live(lab: Driver) -> list[str]:
    """Let time pass, each action taking what its step says, until nothing is left; what was started."""
    order: list[str] = []
    for _ in range(100):
        order += lab.pump()
        ends = {name: _ends_at(lab, name) for name in lab.list_flying()}
        alarm = lab.scheduler.find_next_deadline(lab.state)
        times = [*ends.values(), *([alarm] if alarm is not None else [])]
        if not times:
            return order
        lab.now = max(lab.now, min(times))
        for name, at in ends.items():
            if at <= lab.now:
                lab.finish(name)
    raise AssertionError(lab.describe_stuck())


def _ends_at(lab: Driver, name: ActionId) -> int:
    action = lab.state.actions.open[name]
    seconds = lab.state.runs.plan_of(lab.run(action.run)).steps[action.step].duration_s
    return action.requested_at + int(seconds * SECOND)


def test_a_run_is_not_let_in_where_it_would_tangle_with_a_window() -> None:
    """R1 stands in ``a`` and has to pass ``b`` at once on its way; whoever came into ``b`` and had to go to
    ``a`` from there would have to move in the midst of it."""
    lab = small()
    hurry = lab.submit(
        plan(
            step("arm", take("stack", "a"), duration_s=5.0),
            step("dev", duration_s=60.0),
            step("arm", move("a", "c"), key="out", duration_s=5.0),
            step("arm", move("c", "b"), key="in", duration_s=5.0, windows=(Window(2, 0.0, 1.0),)),
            step("arm", move("b", "trash"), duration_s=5.0),
        )
    )
    lab.step(hurry)
    lab.pump()
    other = lab.submit(
        plan(
            step("arm2", take("stack", "b"), key="enter", duration_s=5.0),
            step("arm2", move("b", "a"), duration_s=5.0),
            step("arm2", move("a", "trash"), duration_s=5.0),
        )
    )
    assert lab.pump() == []
    assert why(lab, other) == f"starting 'enter' now would make run {hurry} late for 'in'"


def test_who_waits_for_a_better_time_goes_on_when_nobody_else_does() -> None:
    """A paused run holds the reader by its plan's word: no time is better than another."""
    lab = small()
    window = Window(1, 0.0, 5.0)
    read = step("cam", key="read", windows=(window,))
    run = lab.submit(plan(step("arm"), step("dev", key="dose", duration_s=10.0), read))
    lab.step(run)
    sitting = lab.submit(plan(step("cam"), step("arm"), step("cam"), holds=(hold("cam", 0, 2),)))
    lab.step(sitting)
    lab.do(PauseRun(lab.run(sitting).id))
    assert lab.pump() == []
    assert why(lab, run, 1) == "if 'dose' started now, 'read' could not start in time"
    lab.now = lab.scheduler.find_next_deadline(lab.state) or 0
    assert lab.pump() == [f"{run}#1"]
    lab.wait(10.0)
    lab.finish(lab.list_flying()[0])
    lab.wait(6.0)
    lab.pump()
    assert "window.breached" in lab.types()
    lab.do(ResumeRun(lab.run(sitting).id))
    live(lab)
    assert not lab.state.runs.active
