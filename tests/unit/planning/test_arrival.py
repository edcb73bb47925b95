"""A run is let in when its labware can go on from the first place: a place that all share stays free."""

from __future__ import annotations

from labos.core.decide.runs import PauseRun
from labos.core.model import Plan
from labos.planning.waiting import PATIENCE
from tests.support.bench import Driver, module, move, plan, station, step, take, workcell

SECOND = 1_000_000_000

CELL = workcell(
    [module("tower"), module("arm"), module("dev"), module("other")],
    [
        station("stack", "stack", 90),
        station("trash", "waste", 90),
        station("hall", "nest"),
        station("shelf", "hotel", 60),
        station("dev.nest", "deck", claim=True),
    ],
)

SLOW = plan(
    step("tower", take("stack", "hall"), key="get", duration_s=40.0),
    step("arm", move("hall", "dev.nest"), key="in", duration_s=30.0),
    step("dev", key="work", duration_s=600.0),
    step("arm", move("dev.nest", "trash"), key="out", duration_s=30.0),
    name="slow",
)
QUICK = plan(
    step("tower", take("stack", "hall"), key="get", duration_s=40.0),
    step("arm", move("hall", "shelf"), key="park", duration_s=30.0),
    name="quick",
)


def at_work(*others: Plan) -> Driver:
    """A lab in which a slow run has just begun to work, for 600 s; the others have asked to come in since."""
    lab = Driver(CELL)
    lab.stock("stack", 80)
    lab.submit(SLOW)
    lab.pump()
    for seconds in (40.0, 30.0):
        lab.wait(seconds)
        lab.finish(lab.list_flying()[0])
        lab.pump()
    for other in others:
        lab.submit(other)
    if QUICK in others:  # one more of them is to come later
        lab.do(PauseRun(lab.submit(QUICK), "ada"))
    return lab


def one_comes(lab: Driver) -> list[str]:
    """Another quick run asks to come in, and goes to its end if it is let in; returns what was started."""
    lab.submit(QUICK)
    started = lab.pump()
    for seconds in (40.0, 30.0):
        for action in lab.list_flying()[1:]:
            lab.wait(seconds)
            lab.finish(action)
        started += lab.pump()
    return started


def why(lab: Driver, run: str) -> str:
    ((_, wait),) = lab.scheduler.list_waits(lab.state, lab.run(run), lab.now)
    return wait.reason.sentence


def test_whoever_would_block_the_shared_place_waits_outside() -> None:
    lab = at_work(SLOW, QUICK)
    assert lab.pump() == ["R3#0"]
    for seconds in (40.0, 30.0):
        lab.wait(seconds)
        lab.finish(lab.list_flying()[-1])
        assert "R2#0" not in lab.pump()
    text = why(lab, "R2")
    assert text.startswith("its first step waits until dev.nest is free (at about ")
    assert text.endswith(" UTC), because the run would block hall before that")


def test_it_is_let_in_in_time() -> None:
    lab = at_work(SLOW, QUICK)
    at_work_since = lab.now
    lab.pump()
    for seconds in (40.0, 30.0):
        lab.wait(seconds)
        lab.finish(lab.list_flying()[-1])
        lab.pump()
    alarm = lab.scheduler.find_next_wake()
    assert alarm is not None
    lab.now = alarm
    assert lab.pump() == ["R2#0"]
    arrives, free = lab.now + 70 * SECOND, at_work_since + 600 * SECOND
    assert free - 150 * SECOND < arrives < free, (
        "its labware is there when the module is free, and not long before"
    )


def test_runs_of_one_kind_do_not_wait_for_each_other() -> None:
    lab = at_work(SLOW)
    assert lab.pump() == ["R2#0"]


def test_nobody_waits_outside_for_ever() -> None:
    lab = at_work(SLOW, QUICK)
    rounds = 0
    while not lab.run("R2").has_started:
        one_comes(lab)
        rounds += 1
        assert rounds <= 2 * PATIENCE
    assert rounds > 3


def test_what_takes_too_long_is_looked_at_again_with_pauses() -> None:
    """The one in the way is overdue, and is followed by a step that would just not end before the other
    arrives: the end that is expected moves on with the clock."""
    slow = plan(
        *SLOW.steps[:3],
        step("dev", key="wash", duration_s=18.8933),
        step("arm", move("dev.nest", "trash"), key="out", duration_s=30.0),
        name="slow",
    )
    lab = Driver(CELL)
    lab.stock("stack", 80)
    lab.submit(slow)
    lab.pump()
    for seconds in (40.0, 30.0):
        lab.wait(seconds)
        lab.finish(lab.list_flying()[0])
        lab.pump()
    lab.submit(slow)
    lab.do(PauseRun(lab.submit(QUICK), "ada"))
    lab.pump()
    lab.wait(620.0)  # longer than 600 s
    for _ in range(100):
        if "R2#0" in lab.pump():
            return
        alarm = lab.scheduler.find_next_wake()
        assert alarm is not None
        assert alarm - lab.now >= SECOND
        lab.now = alarm
