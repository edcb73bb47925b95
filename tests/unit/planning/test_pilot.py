"""Who is let in is looked a long way ahead with: where labware blocks what it stands on."""

from __future__ import annotations

import re

from labos.core.model import Plan
from labos.planning.pilot import MOST_OPTIONS, MOST_WAITING
from tests.support.bench import Driver, module, move, needs, plan, small, station, step, take, workcell

MACHINES = ("mill", "lathe", "oven")
CELL = workcell(
    [module("arm"), *map(module, MACHINES)],
    [
        station("stack", "stack", 90),
        station("trash", "waste", 90),
        *(station(f"{name}.nest", claim=True) for name in MACHINES),
    ],
)


def way(name: str, *stops: tuple[str, float]) -> Plan:
    """A plate's way over machines, on each of which it stays until the next one is free."""
    places = [f"{machine}.nest" for machine, _ in stops]
    steps = [step("arm", take("stack", places[0]), duration_s=10.0)]
    for place, after, (machine, seconds) in zip(places, [*places[1:], "trash"], stops, strict=True):
        steps.append(step(machine, needs(place), duration_s=seconds))
        steps.append(step("arm", move(place, after), duration_s=10.0))
    return plan(*steps, name=name)


LONG_FIRST = way("long first", ("mill", 600.0), ("lathe", 50.0))
LONG_LAST = way("long last", ("mill", 60.0), ("lathe", 300.0))


def lab_with(*plans: Plan, **more: int) -> Driver:
    lab = Driver(CELL)
    lab.stock("stack", 80)
    for each in plans:
        lab.submit(each, **more)
    return lab


def go_on(lab: Driver, times: int) -> list[str]:
    """Let what was requested first end, so many times; returns what was started."""
    started: list[str] = []
    for _ in range(times):
        lab.wait(10.0)
        lab.finish(lab.list_flying()[0])
        started += lab.pump()
    return started


def test_what_has_a_long_way_behind_the_shared_machine_goes_first() -> None:
    lab = lab_with(LONG_FIRST, LONG_LAST)
    assert lab.pump() == ["R2#0"]


def test_runs_of_one_kind_go_by_age_without_a_look() -> None:
    lab = lab_with(LONG_FIRST, LONG_FIRST)
    assert lab.pump() == ["R1#0"]
    assert lab.scheduler.admission.pilot.plays == 0


def test_a_higher_priority_goes_first_all_the_same() -> None:
    lab = lab_with()
    lab.submit(LONG_LAST)
    lab.submit(LONG_FIRST, priority=1)
    assert lab.pump() == ["R2#0"]


def test_users_keep_their_turns() -> None:
    lab = lab_with()
    lab.submit(LONG_LAST, user="ben")
    assert lab.pump() == ["R1#0"]
    go_on(lab, 4)
    lab.submit(LONG_FIRST, user="ada")
    lab.submit(LONG_LAST, user="ben")
    assert go_on(lab, 1) == ["R2#0"], "ada has had less lab time"


def test_who_would_keep_a_run_inside_waiting_waits_outside() -> None:
    lab = lab_with(way("to the oven", ("lathe", 60.0), ("mill", 30.0), ("oven", 500.0)))
    lab.pump()
    assert go_on(lab, 1) == ["R1#1"]
    lab.submit(way("mill only", ("mill", 300.0)))
    assert lab.pump() == []
    ((_, wait),) = lab.scheduler.list_waits(lab.state, lab.run("R2"), lab.now)
    text = wait.reason.sentence
    assert re.fullmatch(
        r"its first step waits, because run R1 would otherwise wait for mill until about .* UTC", text
    ), text
    assert "R2#0" in go_on(lab, 4), "once the mill is free again"


def test_nobody_waits_where_nothing_moves() -> None:
    lab = lab_with(way("to the oven", ("lathe", 60.0), ("mill", 30.0), ("oven", 500.0)))
    lab.pump()
    go_on(lab, 1)
    lab.submit(way("mill only", ("mill", 300.0)))
    assert lab.pump() == []
    lab.doubt(lab.list_flying()[0])
    assert "R2#0" in lab.pump()


def test_a_decision_takes_a_bounded_number_of_plays() -> None:
    stops = [("mill", 10.0 * number) for number in range(3, 23)]
    lab = lab_with(*(way(f"way {number}", stop, ("oven", 30.0)) for number, stop in enumerate(stops)))
    lab.pump()
    assert 2 <= lab.scheduler.admission.pilot.plays <= MOST_OPTIONS + 1
    assert MOST_OPTIONS < MOST_WAITING


def test_runs_that_carry_nothing_start_without_a_look_ahead() -> None:
    lab = small()
    lab.submit(plan(step("dev"), step("cam"), name="both"))
    lab.submit(plan(step("cam"), name="short"))
    lab.pump()
    assert lab.scheduler.admission.pilot.plays == 0


def test_a_bundle_whose_first_run_another_bundle_let_in_waits_for_its_next_run() -> None:
    lab = lab_with(LONG_FIRST, LONG_LAST, LONG_LAST)
    assert lab.pump() == ["R2#0"]
    waits = [wait for who, wait in lab.scheduler.wait_list.list_all() if who in lab.scheduler.room]
    asked = {wait for _, wait in lab.scheduler.list_waits(lab.state, lab.run("R3"), lab.now)}
    assert len(waits) == 2
    assert waits[-1] in asked, waits
