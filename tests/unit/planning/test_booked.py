"""Room between bookings: for a step with what it leaves standing, for a run as a whole, for windows."""

from __future__ import annotations

import pytest

from labos.core.decide.bookings import CancelBooking, MakeBooking, NewTerms
from labos.core.decide.shares import ApplyShares
from labos.core.model import Window
from labos.core.shares import Group, Member
from labos.core.waits import Wait
from labos.planning.scheduler import Scheduler
from labos.planning.stuck import find_block
from tests.support.bench import SECOND, START, Driver, hold, move, plan, sets, small, step, take

MINUTE, HOUR = 60 * SECOND, 3600 * SECOND


def book(
    lab: Driver, target: str, begins_min: float, ends_min: float, user: str = "bo", **more: object
) -> str:
    begins, ends = (START + int(minutes * MINUTE) for minutes in (begins_min, ends_min))
    what = NewTerms(begins=begins, ends=ends, user="" if more.get("maintenance") else user, **more)  # type: ignore[arg-type]
    lab.do(MakeBooking(f"cell/{target}" if target != "cell" else target, what, "op", lab.now))
    return f"B{lab.state.bookings.named}"


def wait_of(lab: Driver, run: str) -> Wait:
    """What the one step of a run whose turn it is waits for."""
    ((_, wait),) = lab.scheduler.list_waits(lab.state, lab.run(run), lab.now)
    return wait


def visit(minutes: float = 30.0, **more: object) -> object:
    """A plate comes to the device, is worked on, and goes to the waste."""
    return plan(
        step("arm", take("stack", "dev.n1"), duration_s=60.0),
        step("dev", duration_s=minutes * 60.0),
        step("arm", move("dev.n1", "trash"), duration_s=60.0),
        **more,  # type: ignore[arg-type]
    )


def test_what_would_still_stand_there_is_not_brought() -> None:
    lab = small()
    run = lab.submit(visit(30))  # type: ignore[arg-type]
    book(lab, "dev", 31, 90)
    assert lab.pump() == []
    wait = wait_of(lab, run)
    assert wait.code == "booked_soon"
    assert wait.until == START + 90 * MINUTE
    told = wait.reason.sentence
    assert told.startswith(
        "dev is booked for bo from 2023-11-14 22:44 UTC until 2023-11-14 23:43 UTC (B1), and"
    )
    assert "labos book cancel B1" in wait.reason.remedy
    lab.now = START + 90 * MINUTE - 1
    assert lab.pump() == []
    lab.now += 1
    assert lab.pump() == [f"{run}#0"], "its deadline wakes it"


def test_a_run_that_has_room_before_goes() -> None:
    lab = small()
    run = lab.submit(visit(30))  # type: ignore[arg-type]
    book(lab, "dev", 32, 90)
    assert lab.pump() == [f"{run}#0"]


def test_whoever_has_booked_goes_on_in_time() -> None:
    lab = small()
    lab.do(ApplyShares("d", (Group("chemistry", 1.0, {"ada": Member(), "cy": Member()}),)))
    begins = START + 10 * MINUTE
    lab.do(
        MakeBooking("cell/dev", NewTerms(begins=begins, ends=begins + HOUR, group="chemistry"), "op", START)
    )
    waits, goes = lab.submit(visit(), user="bo"), lab.submit(visit(), user="cy")  # type: ignore[arg-type]
    assert lab.pump() == [f"{goes}#0"]
    lab.finish(lab.list_flying()[0])
    assert lab.pump() == [f"{goes}#1"]
    assert not lab.run(waits).has_started


def test_who_waits_is_woken_when_a_booking_is_given_back_or_made_for_them() -> None:
    lab = small()
    run = lab.submit(visit())  # type: ignore[arg-type]
    name = book(lab, "dev", 10, 90)
    assert lab.pump() == []
    lab.do(CancelBooking(name, "op"))
    assert lab.pump() == [f"{run}#0"]


def test_a_run_is_let_in_when_all_of_it_has_room() -> None:
    """The camera would be booked when the plate comes there: it would stand in the device meanwhile."""
    lab = small()
    whole = plan(
        step("arm", take("stack", "dev.n1"), duration_s=60.0),
        step("dev", duration_s=1800.0),
        step("arm", move("dev.n1", "cam.nest"), duration_s=60.0),
        step("cam", duration_s=600.0),
        step("arm", move("cam.nest", "trash"), duration_s=60.0),
    )
    run = lab.submit(whole)
    book(lab, "cam", 35, 60)
    assert lab.pump() == []
    wait = wait_of(lab, run)
    assert wait.code == "booked_soon"
    assert wait.until == START + (60 - 31) * MINUTE, "it comes to the camera when that is free"
    lab.now = wait.until
    assert lab.pump() == [f"{run}#0"]


def test_a_run_that_never_fits_as_a_whole_is_let_in_if_each_of_its_stays_has_a_gap() -> None:
    lab = small()
    both = plan(step("dev", duration_s=40 * 60.0), step("cam", duration_s=40 * 60.0))
    run = lab.submit(both)
    book(lab, "dev", 60 * 24 - 30, 60 * 24, rule="FREQ=DAILY")
    book(lab, "cam", 60, 60 * 24 + 15, rule="FREQ=DAILY")  # free from 15 to 60 minutes past
    assert lab.pump() == [f"{run}#0"]
    action = lab.list_flying()[0]
    lab.wait(40 * 60)
    lab.finish(action)
    assert lab.pump() == []
    assert wait_of(lab, run).code == "booked_soon"
    lab.now = START + (60 * 24 + 15) * MINUTE
    assert lab.pump() == [f"{run}#1"]


def test_bookings_without_a_gap_are_said_and_nobody_waits_in_silence() -> None:
    lab = small()
    run = lab.submit(visit(60))  # type: ignore[arg-type]
    book(lab, "dev", 30, 60 * 24 - 10, rule="FREQ=DAILY")  # 40 minutes free a day
    lab.pump()
    wait = wait_of(lab, run)
    assert wait.code == "no_gap"
    assert wait.reason.sentence == "the bookings of dev (B1) leave no free time of 62 min in the next 14 days"
    assert "labos bookings dev" in wait.reason.remedy
    short = lab.submit(visit(10), user="cy")  # type: ignore[arg-type]
    assert lab.pump() == [f"{short}#0"], "nobody waits with it"
    lab.finish(lab.list_flying()[0])
    lab.step(short, 1)
    lab.step(short, 2)
    lab.do(CancelBooking("B1", "op"))
    assert lab.pump() == [f"{run}#0"]


def test_a_run_inside_that_has_no_gap_any_more_is_an_obstacle_and_no_reason_to_wait() -> None:
    lab = small()
    stands = lab.submit(visit(60))  # type: ignore[arg-type]
    lab.pump()
    lab.finish(lab.list_flying()[0])
    book(lab, "dev", 5, 60 * 24 - 10, rule="FREQ=DAILY")
    lab.pump()
    assert wait_of(lab, stands).code == "no_gap"
    stuck = find_block(lab.state, lab.run(stands))
    assert stuck is not None
    assert stuck.code == "no_gap"
    other = lab.submit(plan(step("arm", take("stack", "a")), step("arm", move("a", "trash"))))
    assert lab.pump() == [f"{other}#0"]


def test_safety_takes_runs_for_stuck_while_a_booking_has_begun() -> None:
    lab = small()
    run = lab.submit(visit(10))  # type: ignore[arg-type]
    lab.pump()
    lab.finish(lab.list_flying()[0])
    book(lab, "dev", 5, 60)
    lab.pump()
    assert wait_of(lab, run).code == "booked_soon"
    assert find_block(lab.state, lab.run(run)) is None
    lab.now = START + 5 * MINUTE
    lab.pump()
    stuck = find_block(lab.state, lab.run(run))
    assert stuck is not None
    assert stuck.code == "booked"
    lab.now = START + 60 * MINUTE
    assert lab.pump() == [f"{run}#1"], "it goes on after the booking"


def test_a_step_whose_follower_has_to_come_in_time_waits_with_it() -> None:
    lab = small()
    window = Window(anchor=0, wait_s=0.0, within_s=600.0)
    timed = plan(step("cam", duration_s=60.0), step("dev", duration_s=600.0, windows=(window,)))
    inside = lab.submit(plan(step("arm2", duration_s=1.0), *timed.steps[:0], step("cam", duration_s=60.0)))
    run = lab.submit(timed)
    book(lab, "dev", 5, 60)
    assert lab.pump() == [f"{inside}#0"]
    wait = wait_of(lab, run)
    assert wait.until == START + 59 * MINUTE, "the device is free when its turn comes"


def test_a_hold_and_a_lid_count_until_they_are_over() -> None:
    for steps, holds in (
        ((step("dev", duration_s=60.0), step("cam", duration_s=1800.0)), (hold("dev", 0, 1),)),
        (
            (
                step("dev", sets("lid", "closed"), duration_s=60.0),
                step("cam", duration_s=1800.0),
                step("dev", sets("lid", "open"), duration_s=60.0),
            ),
            (),
        ),
    ):
        lab = small()
        run = lab.submit(plan(*steps, holds=holds))
        book(lab, "dev", 20, 60)
        assert lab.pump() == []
        assert wait_of(lab, run).until == START + 60 * MINUTE


def test_a_workcell_that_is_booked_takes_all_its_modules() -> None:
    lab = small()
    run = lab.submit(plan(step("cam", duration_s=60.0)))
    mine = lab.submit(plan(step("cam", duration_s=60.0)), user="bo")
    book(lab, "cell", 0, 60)
    assert lab.pump() == [f"{mine}#0"]
    assert wait_of(lab, run).code == "booked"


def test_others_are_looked_at_apart_though_their_runs_are_alike() -> None:
    lab = small()
    names = [lab.submit(plan(step("cam", duration_s=60.0)), user=user) for user in ("ada", "bo", "cy", "bo")]
    book(lab, "cam", 0, 60)
    started = []
    for _ in range(4):
        started += lab.pump()
        for action in lab.list_flying():
            lab.finish(action)
    assert started == [f"{names[1]}#0", f"{names[3]}#0"]


@pytest.mark.parametrize("begins_min", [0, 5])
def test_what_is_booked_does_not_keep_younger_ones_out(begins_min: float) -> None:
    """An elder that waits for a booking protects nothing."""
    lab = small()
    elder = lab.submit(visit(60))  # type: ignore[arg-type]
    book(lab, "dev", begins_min, 600)
    assert not wait_of(lab, elder).blocked, "it passes by itself"
    done = 0
    for _ in range(20):
        lab.submit(plan(step("arm", duration_s=1.0)), user="cy")
        done += len(lab.pump())
        for action in lab.list_flying():
            lab.finish(action)
    assert done == 20


def test_labs_without_bookings_ask_nothing() -> None:
    lab = small()
    run = lab.submit(visit())  # type: ignore[arg-type]
    assert Scheduler().find_next_deadline(lab.state) is None
    assert lab.pump() == [f"{run}#0"]


def test_a_short_step_starts_before_a_booking_though_a_longer_one_has_to_wait() -> None:
    """Runs that begin alike are looked at together: not where their first steps last differently."""
    lab = small()
    name = book(lab, "dev", 10, 90)
    longer, shorter = lab.submit(plan(step("dev", duration_s=1800.0))), lab.submit(plan(step("dev")))
    assert lab.pump() == [f"{shorter}#0"]
    lab.finish(lab.list_flying()[0])
    assert lab.pump() == []
    assert wait_of(lab, longer).code == "booked_soon"
    lab.do(CancelBooking(name, "op"))
    assert lab.pump() == [f"{longer}#0"]
