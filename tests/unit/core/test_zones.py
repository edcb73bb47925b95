"""Zones: one arm at a time, until it is known to have come out."""

from __future__ import annotations

from labos.core.decide.nodes import ReportState
from labos.core.ids import ModuleName
from labos.core.waits import Wait
from labos.planning.timetable import make_timetable
from tests.support.bench import Driver, module, move, needs, plan, route, station, step, workcell

Z = "cell/z"


def make_shared() -> Driver:
    """Two arms; ``a`` and ``b`` lie in one zone, ``c`` and ``d`` in none; ``gantry`` is in it."""
    lab = Driver(
        workcell(
            [module("arm"), module("arm2"), module("gantry", zone=Z), module("cam")],
            [
                station("stack", "stack", 9),
                station("a", zone=Z),
                station("b", zone=Z),
                *map(station, ("c", "d", "e")),
            ],
        )
    )
    lab.stock("stack", 9)
    return lab


def wait(lab: Driver, run: str, index: int = 0) -> Wait:
    found = lab.check_start(run, index)
    assert isinstance(found, Wait), found
    return found


def test_an_arm_stays_out_while_another_is_in_the_zone() -> None:
    lab = make_shared()
    lab.stock("b", 1)
    first = lab.start(lab.submit(route("stack", "a", "e")))
    other = lab.submit(route("b", "c", arm="arm2"))
    assert wait(lab, other).names == ("cell/arm", Z)
    assert wait(lab, other).reason.sentence == "arm is working in the zone z"
    assert lab.code(lab.submit(route("c", "d", arm="arm2"))) == "nothing_there"
    lab.finish(first)
    assert lab.code(other) == ""


def test_a_module_with_a_zone_of_its_own_is_there_whenever_it_acts() -> None:
    lab = make_shared()
    lab.stock("b", 1)
    going = lab.start(lab.submit(plan(step("gantry"), step("cam"))))
    assert lab.code(lab.submit(route("b", "c"))) == "zone_busy"
    assert lab.code(lab.submit(plan(step("gantry", exclusive=False)))) == ""
    lab.finish(going)
    lab.start(lab.submit(route("b", "c")))
    assert lab.code(lab.submit(plan(step("gantry")))) == "zone_busy"


def test_who_lifts_something_at_a_station_reaches_into_its_zone() -> None:
    lab = make_shared()
    lab.stock("a", 1)
    lab.start(lab.submit(plan(step("arm", needs("a")))))
    assert lab.code(lab.submit(route("stack", "b", arm="arm2"))) == "zone_busy"


def test_the_end_of_an_action_wakes_who_waits_for_the_zone() -> None:
    lab = make_shared()
    lab.stock("b", 1)
    lab.submit(plan(step("arm", move("b", "c")), step("cam")))
    waiting = lab.submit(route("stack", "a", arm="arm2"))
    assert lab.pump() == ["R1#0"]
    lab.finish("A1")
    assert f"{waiting}#0" in lab.pump()
    assert lab.find_missed() == []


def test_an_arm_that_failed_bars_the_zone_until_it_is_idle() -> None:
    lab = make_shared()
    lab.stock("b", 1)
    action = lab.start(lab.submit(route("b", "c")))
    lab.do(ReportState(ModuleName("cell/arm"), "ERROR", "jam"))
    lab.fail(action, "none")
    other = lab.submit(route("stack", "a", arm="arm2"))
    found = wait(lab, other)
    assert (found.code, found.names, found.blocked) == ("zone_barred", ("cell/arm", Z), True)
    assert found.reason.remedy == "Check it, then: labos reset arm"
    healed = lab.submit(plan(step("arm", action="reset", recovers=True)))
    lab.pump()
    assert lab.code(other) == "zone_barred", "the reset does not wait for the zone, others do"
    lab.finish(lab.list_flying()[0])
    assert healed not in lab.state.runs.active
    assert f"{other}#0" in lab.pump()


def test_a_gantry_that_failed_in_its_own_zone_bars_it_too() -> None:
    lab = make_shared()
    lab.fail(lab.start(lab.submit(plan(step("gantry")))))
    lab.do(ReportState(ModuleName("cell/gantry"), "ERROR", "jam"))
    assert lab.code(lab.submit(route("stack", "a"))) == "zone_barred"
    lab.do(ReportState(ModuleName("cell/gantry"), "IDLE"))
    assert lab.code(lab.submit(route("stack", "a"))) == ""


def test_safety_counts_who_waits_for_a_barred_zone_as_stuck() -> None:
    """Its labware is an obstacle then: nobody may rely on its going away."""
    lab = make_shared()
    inside = lab.submit(route("stack", "c", "b", "e", arm="arm2"))
    lab.step(inside)
    lab.stock("a", 1)
    lost = lab.start(lab.submit(route("a", "d")))
    assert not any(actor.stuck for actor in lab.scheduler.safety.list_actors(lab.state, "cell"))
    lab.doubt(lost)
    actors = lab.scheduler.safety.list_actors(lab.state, "cell")
    assert [actor.stuck for actor in actors if actor.name == inside] == [True]


def test_a_timetable_knows_zones() -> None:
    cell = workcell(
        [module("arm"), module("arm2")], [station("a", zone=Z), station("b", zone=Z), station("c")]
    )
    both = plan(step("arm", move("a", "c")), step("arm2", move("b", "c")), parallel=True)
    assert [slot.start_s for slot in make_timetable(both).slots] == [0, 0]
    assert [slot.start_s for slot in make_timetable(both, cell).slots] == [0, 1]
