"""Due dates: they order the runs of one user, and nobody else's; whether they are kept is foreseen."""

from __future__ import annotations

import pytest

from labos.core.decide.shares import ApplyShares
from labos.core.ids import RunId
from labos.core.model import Plan
from labos.core.shares import Group, Member
from labos.core.state import encode_picture
from labos.planning.due import UNDATED, DueDates, find_time_left
from labos.planning.hindsight import TimeRange
from labos.planning.lab_forecast import ForecastRequest, forecast_lab
from labos.planning.waiting import PATIENCE
from labos.services.due import describe_margin
from tests.support.bench import SECOND, Driver, module, plan, small, step, workcell

MINUTE = 60 * SECOND
HOUR = 60 * MINUTE
READ = plan(step("dev", key="read", duration_s=600.0), name="read")
LOOK = plan(step("dev", key="look", duration_s=3000.0), name="look")


def let_in(lab: Driver) -> list[str]:
    """All runs, in the order in which they are let in; each one ends before the next one is."""
    found: list[str] = []
    while lab.state.runs.queued or lab.state.actions.open:
        found += [name.partition("#")[0] for name in lab.pump()]
        lab.wait(600.0)
        for action in list(lab.state.actions.open):
            lab.finish(action)
    return found


def test_of_one_user_the_run_that_is_due_first_goes_first() -> None:
    lab = small()
    never, late, soon = (
        lab.submit(READ),
        lab.submit(READ, due_at=lab.now + 9 * HOUR),
        lab.submit(READ, due_at=lab.now + HOUR),
    )
    assert let_in(lab) == [soon, late, never]


def test_what_takes_longer_has_less_time_to_spare() -> None:
    """Both are due soon, and the one that is due later has less time left before it has to begin."""
    lab = small()
    short = lab.submit(READ, due_at=lab.now + 60 * MINUTE)
    long = lab.submit(LOOK, due_at=lab.now + 70 * MINUTE)
    assert let_in(lab) == [long, short]


def test_a_priority_goes_before_a_due_date() -> None:
    lab = small()
    due, higher = lab.submit(READ, due_at=lab.now + HOUR), lab.submit(READ, priority=1)
    assert let_in(lab) == [higher, due]


def test_nobody_else_waits_for_a_due_date() -> None:
    """Whoever writes early due dates on everything has no more of the lab than the others."""
    lab = small()
    for _ in range(12):
        lab.submit(READ, "hasty", due_at=lab.now + MINUTE)
        lab.submit(READ, "calm")
    users = {run.id: run.user for run in lab.state.runs.queued.values()}
    order = [users[RunId(name)] for name in let_in(lab)]
    assert [order[:n].count("hasty") for n in (4, 8, 12)] == [2, 4, 6]


def test_a_group_has_no_more_of_the_lab_by_due_dates() -> None:
    lab = small()
    lab.do(ApplyShares("d", (Group("g", 2.0, {"a": Member()}), Group("h", 1.0, {"b": Member()}))))
    for _ in range(9):
        lab.submit(READ, "a")
        lab.submit(READ, "b", due_at=lab.now + MINUTE)
    users = {run.id: run.user for run in lab.state.runs.queued.values()}
    order = [users[RunId(name)] for name in let_in(lab)]
    assert order[:9].count("a") == 6


def test_a_run_without_a_due_date_is_not_overtakings_for_ever() -> None:
    lab = small()
    old = lab.submit(READ)
    passed: list[str] = []
    while RunId(old) in lab.state.runs.queued:
        while len(lab.state.runs.queued) < 3:
            lab.submit(READ, due_at=lab.now + MINUTE)
        passed += [name.partition("#")[0] for name in lab.pump()]
        lab.wait(600.0)
        for action in list(lab.state.actions.open):
            lab.finish(action)
    assert len(passed) <= PATIENCE + 1
    assert passed[-1] == old


def test_inside_too_the_run_that_is_due_first_goes_first() -> None:
    """Both wait for the same device when it becomes free."""
    lab = Driver(workcell([module(name) for name in ("a", "b", "dev")], []))
    through = [plan(step(name, key="in"), step("dev", key="read"), name=name) for name in "ab"]
    first = lab.submit(plan(step("dev", key="hold"), name="hold"))
    lab.pump()
    calm, hasty = lab.submit(through[0]), lab.submit(through[1], due_at=lab.now + HOUR)
    lab.pump()
    for action in [a.id for a in lab.state.actions.open.values() if a.run != first]:
        lab.finish(action)
    assert lab.pump() == []
    lab.finish(lab.list_flying()[0])
    assert lab.pump() == [f"{hasty}#1"]
    assert lab.run(calm).id == calm


def test_time_left_is_the_longest_chain_of_what_is_not_done() -> None:
    lab = small()
    whole = plan(step("dev", key="a", duration_s=100.0), step("cam", key="b", duration_s=50.0), name="two")
    run = lab.submit(whole, due_at=lab.now + HOUR)
    assert find_time_left(lab.state, lab.run(run)) == 150 * SECOND
    lab.step(run)
    assert find_time_left(lab.state, lab.run(run)) == 50 * SECOND
    assert DueDates().rank(lab.state, lab.run(run)) == lab.run(run).due_at - 50 * SECOND
    assert DueDates().rank(lab.state, lab.run(lab.submit(READ))) == UNDATED


def two_due(lab: Driver, first: Plan = READ) -> list[float | None]:
    """By how much the second of two runs on one device is late, as the forecast says."""
    lab.submit(first, due_at=lab.now + 10 * MINUTE)
    lab.submit(READ, due_at=lab.now + 15 * MINUTE)
    told = forecast_lab(ForecastRequest(encode_picture(lab.state), lab.now))
    return [run.late_by_s for run in told.runs]


def test_a_forecast_says_by_how_much_a_run_is_late() -> None:
    assert two_due(small()) == [0.0, 300.0]


@pytest.mark.parametrize(
    ("ends", "told"),
    [
        (None, "its end cannot be estimated"),
        ((0, 70, 80), "late by about 20 s"),
        ((0, 890, 900), "late by about 14 min"),
        ((0, 40, 7250), "may be late, by up to 2 h 00 min"),
        ((0, 20, 45), "kept, with about 30 s to spare"),
    ],
)
def test_it_is_told_in_words(ends: tuple[int, int, int] | None, told: str) -> None:
    times = TimeRange(*(at * SECOND for at in ends)) if ends else None
    assert describe_margin(50 * SECOND, times) == told
