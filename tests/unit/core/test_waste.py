"""A waste is finite: full, it keeps others waiting until somebody has emptied it."""

from __future__ import annotations

from labos.core.decide.stock import UnloadStation
from labos.core.ids import StationName
from labos.core.labware import StationUnloaded
from labos.core.waits import Wait
from labos.planning.obstacle import find_obstacle
from tests.support.bench import Driver, full, route, small

TRASH = StationName(full("trash"))


def fill(lab: Driver, count: int) -> None:
    lab.stock("trash", count, "rubbish")


def test_a_full_waste_says_what_to_do_and_goes_on_when_it_was_emptied() -> None:
    lab = small()
    run = lab.submit(route("stack", "a", "trash"))
    lab.step(run)
    fill(lab, 4)
    found = lab.check_start(run, 1)
    assert isinstance(found, Wait)
    assert (found.code, found.blocked) == ("waste_full", True)
    assert found.reason.sentence == "the waste trash is full"
    assert found.reason.remedy == "Empty it and report that: labos unload trash --all"
    assert lab.pump() == []
    lab.do(UnloadStation(TRASH, "ada"))
    assert lab.state.bench.stations[TRASH].level == 0
    assert lab.pump() == [f"{run}#1"], "it is woken"
    lab.check_log()


def test_nobody_is_let_in_whose_labware_would_find_the_waste_full() -> None:
    lab = small()
    fill(lab, 3)
    first = lab.submit(route("stack", "a", "trash"))
    lab.step(first)
    second = lab.submit(route("stack", "b", "trash", arm="arm2"))
    assert lab.scheduler.safety.list_trapped(lab.state, lab.run(second), 0) == [second]
    told = find_obstacle(lab.scheduler.safety, lab.state, lab.run(second))
    why = "needs room in the waste trash, which is full by then (labos unload trash --all)"
    assert told == f"'to trash' {why}"
    assert f"{second}#0" not in lab.pump()
    lab.do(UnloadStation(TRASH, "ada"))
    assert f"{second}#0" in lab.pump(), "it is let in"


def test_it_may_be_emptied_while_something_is_thrown_in() -> None:
    lab = small()
    run = lab.submit(route("stack", "a", "trash"))
    fill(lab, 2)
    lab.step(run)
    action = lab.start(run, 1)
    lab.do(UnloadStation(TRASH, "ada"))
    assert lab.state.bench.stations[TRASH].count == 1
    lab.finish(action)
    assert lab.state.bench.stations[TRASH].level == 1


def test_who_waited_for_room_is_named() -> None:
    lab = small()
    run = lab.submit(route("stack", "a", "trash"))
    lab.step(run)
    fill(lab, 3)
    (in_time,) = lab.do(UnloadStation(TRASH, "ada", count=1))
    assert isinstance(in_time, StationUnloaded)
    assert in_time.awaited == ()
    fill(lab, 4)
    (late,) = lab.do(UnloadStation(TRASH, "ada"))
    assert isinstance(late, StationUnloaded)
    assert (late.count, late.awaited) == (4, (run,))
    assert lab.reject(UnloadStation(TRASH, "ada")).message == "trash holds 0."
