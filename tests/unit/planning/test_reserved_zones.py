"""Zones are kept for the arm that has to be there in time."""

from __future__ import annotations

from labos.core.model import Window
from tests.support.bench import Driver, module, move, plan, station, step, workcell
from tests.unit.planning.test_reservations import start_clock, why


def in_one_zone() -> Driver:
    """Two arms over one corner: each has a nest there."""
    cell = workcell(
        [module("dev"), module("arm"), module("arm2")],
        [station("a", zone="cell/z"), station("b", zone="cell/z"), station("x"), station("y")],
    )
    lab = Driver(cell)
    for name in ("x", "y"):
        lab.stock(name, 1)
    return lab


def test_a_zone_is_kept_for_the_arm_that_has_to_be_there_in_time() -> None:
    lab = in_one_zone()
    carried = step("arm", move("x", "a"), key="over", duration_s=10.0, windows=(Window(0, 60.0, 100.0),))
    start_clock(lab, plan(step("dev", duration_s=10.0), carried))
    run = lab.submit(plan(step("arm2", move("y", "b"), duration_s=95.0)))
    assert lab.pump() == []
    wait = why(lab, run)
    assert wait is not None
    assert wait.reason.sentence == "z is reserved for run R1, whose step 'over' has to start in time"
    assert "zone:cell/z" in wait.on
    lab.wait(60.0)
    assert lab.pump() == ["R1#1"]
    lab.finish(lab.list_flying()[0])
    assert lab.pump() == [f"{run}#0"]
    assert lab.find_missed() == []


def test_a_clock_is_not_started_while_another_arm_stays_in_the_zone() -> None:
    lab = in_one_zone()
    lab.start(lab.submit(plan(step("arm2", move("y", "b"), duration_s=300.0))))
    over = step("arm", move("x", "a"), key="over", duration_s=10.0, windows=(Window(0, 0.0, 100.0),))
    run = lab.submit(plan(step("dev", duration_s=10.0), over))
    wait = why(lab, run)
    assert wait is not None
    assert (wait.code, wait.names) == ("not_in_time", ("cell/z", "over"))
