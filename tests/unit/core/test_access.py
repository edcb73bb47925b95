"""A person reaches into a workcell: nothing starts, nothing moves, what was changed is written."""

from __future__ import annotations

from labos.core.decide.access import EndAccess, ReportedChange, RequestAccess
from labos.core.decide.runs import SubmitRun
from labos.core.ids import StationName
from tests.support.bench import CELL, Driver, full, plan, route, small, step


def inside(lab: Driver, *changes: tuple[str, str]) -> EndAccess:
    return EndAccess(
        CELL, "ada", "", tuple(ReportedChange(StationName(full(s)), what) for s, what in changes)
    )


def make_held() -> Driver:
    """Two runs, one of them in flight, and somebody who wants to reach in."""
    lab = small()
    lab.submit(route("stack", "a", "b", "trash"))
    lab.submit(route("stack", "c", "trash", arm="arm2"))
    lab.start("R1", 0)
    lab.do(RequestAccess(CELL, "ada", "oil"))
    lab.pump()
    return lab


def test_what_is_in_flight_ends_first_and_nothing_starts() -> None:
    lab = make_held()
    assert lab.types()[-1] == "workcell.access_requested"
    assert lab.code("R2") == "access"
    lab.finish(lab.list_flying()[0])
    lab.pump()
    assert lab.types()[-1] == "workcell.access_granted"
    assert lab.pump() == []
    assert lab.find_missed() == []
    lab.do(inside(lab))
    assert lab.pump()
    lab.check_log()


def test_arms_are_parked_before_it_is_granted_and_not_after() -> None:
    home = plan(step("arm2", action="home"), name="do arm2.home")
    lab = small()
    lab.do(RequestAccess(CELL, "ada", "", (SubmitRun(home, "ada"),)))
    assert lab.pump() == ["R1#0"]
    assert lab.types()[-1] == "action.requested"
    lab.finish(lab.list_flying()[0])
    lab.pump()
    assert lab.types()[-1] == "workcell.access_granted"
    lab.submit(home)
    assert lab.pump() == []
    assert lab.code("R2") == "access"


def test_only_one_person_at_a_time() -> None:
    lab = make_held()
    assert lab.do(RequestAccess(CELL, "ada")) == []
    assert lab.reject(RequestAccess(CELL, "bo")).code == "occupied"
    assert lab.reject(RequestAccess("nowhere", "bo")).code == "no_workcell"
    lab.do(inside(lab))
    assert lab.reject(inside(lab)).code == "no_access"


def test_what_was_changed_is_written_when_the_person_is_out() -> None:
    lab = small()
    lab.stock("a", 1)
    lab.stock("b", 1)
    lab.do(RequestAccess(CELL, "ada"))
    lab.pump()
    lab.do(inside(lab, ("a", "plate"), ("a", "empty"), ("c", "P2"), ("b", "plate")))
    assert (lab.at("a"), lab.at("b"), lab.at("c")) == (["P3"], ["P4"], ["P2"])
    lab.check_log()


def test_what_was_moved_from_a_station_that_was_cleared_has_not_left_the_bench() -> None:
    lab = small()
    lab.stock("a", 1)
    lab.stock("b", 1)
    lab.do(RequestAccess(CELL, "ada"))
    lab.pump()
    lab.do(inside(lab, ("a", "empty"), ("c", "P1"), ("b", "P2"), ("b", "empty")))
    assert (lab.at("a"), lab.at("b"), lab.at("c")) == ([], ["P2"], ["P1"])
    lab.check_log()


def test_changes_that_cannot_be_are_refused_and_the_workcell_stays_held() -> None:
    lab = small()
    lab.stock("a", 1)
    lab.do(RequestAccess(CELL, "ada"))
    assert lab.reject(inside(lab, ("a", "plate"))).code == "station_occupied"
    assert lab.reject(inside(lab, ("nowhere", "empty"))).code == "no_station"
    assert lab.reject(inside(lab, ("stack", "plate"))).code == "stack"
    assert CELL in lab.state.lab.access
