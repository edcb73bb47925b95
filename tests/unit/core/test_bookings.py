"""Bookings: made, changed, given back, begun and ended; who may, and what stands in the way."""

from __future__ import annotations

from datetime import datetime
from zoneinfo import ZoneInfo

import pytest

from labos.core.bookings import LEAD_NS, Booking
from labos.core.decide import Command, Rejection
from labos.core.decide.bookings import (
    BeginBooking,
    CancelBooking,
    ChangeBooking,
    EndBooking,
    MakeBooking,
    NearBooking,
    NewTerms,
)
from labos.core.decide.rights import Denied
from labos.core.decide.shares import ApplyShares
from labos.core.decide.submissions import ApplyPolicy
from labos.core.decide.users import AddGroup, AddMember, AddUser, GrantRole
from labos.core.policy import BookingLimits, Policy
from labos.core.recurrence import DAY_NS, find_rule_fault, in_zone, list_times_between
from labos.core.shares import Group, Member
from tests.support.bench import SECOND, START, Driver, move, plan, small, step, take

MINUTE, HOUR = 60 * SECOND, 3600 * SECOND
DEV, CELL = "cell/dev", "cell"
ZURICH = "Europe/Zurich"


def local_ns(text: str, zone: str = ZURICH) -> int:
    return int(datetime.fromisoformat(text).replace(tzinfo=ZoneInfo(zone)).timestamp()) * SECOND


def terms(begins: float = 1, ends: float = 2, user: str = "bo", **more: object) -> NewTerms:
    """From and to so many hours after the start of the lab."""
    if more.get("group") or more.get("maintenance"):
        user = ""
    return NewTerms(begins=START + int(begins * HOUR), ends=START + int(ends * HOUR), user=user, **more)  # type: ignore[arg-type]


def book(
    lab: Driver,
    what: NewTerms,
    target: str = DEV,
    by: str = "op",
    *,
    force: bool = False,
    actor: str = "labos",
) -> str:
    lab.do(MakeBooking(target, what, by, lab.now, force), actor)
    return f"B{lab.state.bookings.named}"


def booking(lab: Driver, name: str) -> Booking:
    return lab.state.bookings.open[name]


def make_shared() -> Driver:
    """A lab with an admin, an operator, and two submitters, one of them in a group."""
    lab = small()
    for user in ("root", "op", "ada", "bo", "cy"):
        lab.do(AddUser(user))
    lab.do(AddGroup("chemistry"))
    lab.do(AddMember("chemistry", "ada"))
    lab.do(AddMember("chemistry", "cy"))
    lab.do(GrantRole("user:op", "operator", "cell"))
    for user in ("ada", "bo", "cy"):
        lab.do(GrantRole(f"user:{user}", "submitter", "cell"))
    return lab


def test_a_booking_comes_near_begins_and_ends() -> None:
    lab = small()
    name = book(lab, terms())
    lab.pump()
    assert lab.types()[-1] == "booking.made"
    lab.now = START + HOUR - LEAD_NS
    lab.pump()
    assert lab.types()[-1] == "booking.neared"
    lab.now = START + HOUR
    lab.pump()
    assert (lab.types()[-1], booking(lab, name).until) == ("booking.began", START + 2 * HOUR)
    assert lab.scheduler.find_next_deadline(lab.state) == START + 2 * HOUR
    lab.now = START + 2 * HOUR
    lab.pump()
    assert lab.types()[-1] == "booking.ended"
    assert not lab.state.bookings.open
    assert not lab.state.bookings.on
    assert lab.scheduler.find_next_deadline(lab.state) is None
    lab.check_log()


def test_what_is_due_is_due_once_and_not_before() -> None:
    lab = small()
    name = book(lab, terms())
    for early in (NearBooking(name, lab.now), BeginBooking(name, lab.now), EndBooking(name, lab.now)):
        assert lab.do(early) == []
    assert lab.do(EndBooking("B9", lab.now)) == []


def test_a_lab_that_was_down_takes_note_of_what_it_missed_once() -> None:
    lab = small()
    once = book(lab, terms(1, 2))
    daily = book(lab, terms(3, 4, rule="FREQ=DAILY"))
    lab.now = START + 10 * DAY_NS
    before = len(lab.log)
    lab.pump()
    ended = [entry.event for entry in lab.log[before:]]
    assert [(event.TYPE, event.booking) for event in ended] == [  # type: ignore[attr-defined]
        ("booking.ended", once),
        ("booking.ended", daily),
    ]
    assert booking(lab, daily).next_change == START + 3 * HOUR + 10 * DAY_NS - LEAD_NS
    lab.check_log()


@pytest.mark.parametrize(
    ("wrong", "code"),
    [
        (MakeBooking("cell/none", terms(), "op", START), "no_target"),
        (MakeBooking(DEV, terms(2, 2), "op", START), "bad_time"),
        (MakeBooking(DEV, terms(1, 10_000), "op", START), "bad_time"),
        (MakeBooking(DEV, terms(-2, -1), "op", START), "past"),
        (MakeBooking(DEV, terms(-2, -1, rule="FREQ=DAILY;COUNT=1"), "op", START), "past"),
        (MakeBooking(DEV, terms(zone="Europe/Zug"), "op", START), "bad_zone"),
        (MakeBooking(DEV, terms(zone="../../etc/passwd"), "op", START), "bad_zone"),
        (MakeBooking(DEV, terms(rule="FREQ=HOURLY"), "op", START), "bad_rule"),
        (MakeBooking(DEV, terms(rule="FREQ=DAILY;BYSECOND=1"), "op", START), "bad_rule"),
        (MakeBooking(DEV, terms(rule="FREQ=WEEKLY;INTERVAL=0"), "op", START), "bad_rule"),
        (MakeBooking(DEV, terms(rule="FREQ=WEEKLY\nRRULE:FREQ=DAILY"), "op", START), "bad_text"),
        (MakeBooking(DEV, terms(rule="FREQ=DAILY;BYDAY=XX"), "op", START), "bad_rule"),
        (MakeBooking(DEV, terms(rule="FREQ=DAILY;BYMONTH=2;BYMONTHDAY=30"), "op", START), "bad_rule"),
        (MakeBooking(DEV, terms(rule="FREQ=DAILY;COUNT=0"), "op", START), "bad_rule"),
        (MakeBooking(DEV, terms(rule="FREQ=DAILY;BYSETPOS=5"), "op", START), "bad_rule"),
        (MakeBooking(DEV, terms(rule="FREQ=MONTHLY;BYDAY=TU;BYSETPOS=77"), "op", START), "bad_rule"),
        (MakeBooking(DEV, terms(rule="FREQ=MONTHLY;BYDAY=6TU"), "op", START), "bad_rule"),
        (MakeBooking(DEV, terms(why="x" * 2_000), "op", START), "bad_text"),
        (MakeBooking(DEV, terms(1, 30, rule="FREQ=DAILY"), "op", START), "bad_rule"),
        (MakeBooking(DEV, terms(last=START + DAY_NS), "op", START), "bad_rule"),
        (MakeBooking(DEV, terms(user=""), "op", START), "for_whom"),
        (
            MakeBooking(DEV, NewTerms(begins=START, ends=START + HOUR, user="a", group="b"), "op", START),
            "for_whom",
        ),
        (MakeBooking(DEV, terms(group="none"), "op", START), "no_group"),
        (ChangeBooking("B7", terms(), "op", START), "no_booking"),
        (CancelBooking("B7", "op"), "no_booking"),
    ],
)
def test_what_cannot_be_booked(wrong: Command, code: str) -> None:
    refusal = small().reject(wrong)
    assert refusal.code == code
    assert refusal.remedy or code == "bad_time"


def test_an_overlap_is_refused_by_the_name_of_the_other_unless_by_force() -> None:
    lab = small()
    first = book(lab, terms(1, 3))
    refusal = lab.reject(MakeBooking(DEV, terms(2, 4, "cy"), "cy", lab.now))
    assert refusal.code == "booked"
    assert first in refusal.message
    assert "dev is booked for bo from" in refusal.message
    assert "ask op" in refusal.remedy
    assert book(lab, terms(3, 4, "cy")) == "B2", "it begins when the other ends"
    assert lab.reject(MakeBooking(CELL, terms(2, 3, "cy"), "cy", lab.now)).code == "booked"
    assert lab.reject(ChangeBooking(first, terms(1, 3.5), "op", lab.now)).code == "booked"
    lab.do(ChangeBooking(first, terms(1.5, 3), "op", lab.now))
    over = book(lab, terms(2, 4, "cy"), force=True)
    assert lab.log[-1].event.over == (first, "B2")  # type: ignore[attr-defined]
    assert over == "B3"
    lab.check_log()


def test_nothing_is_booked_over_maintenance() -> None:
    lab = small()
    name = book(lab, terms(1, 3, maintenance=True))
    refusal = lab.reject(MakeBooking(DEV, terms(2, 4), "op", lab.now, force=True))
    assert refusal.code == "booked"
    assert f"labos book change {name}" in refusal.remedy
    assert book(lab, terms(2, 4, maintenance=True), force=True) == "B2"


def test_a_booking_of_a_workcell_meets_those_of_its_modules_however_far_ahead() -> None:
    lab = small()
    weekly = book(lab, terms(1, 2, rule="FREQ=WEEKLY"))
    at = 24 * 7 * 30 + 1.5
    refusal = lab.reject(MakeBooking(CELL, terms(at, at + 1, "cy"), "cy", lab.now))
    assert weekly in refusal.message
    assert book(lab, terms(at + 1, at + 2, "cy"), CELL) == "B2"


def test_the_clock_on_the_wall_stays_when_clocks_are_changed() -> None:
    """Switzerland goes to summer time on 29 March 2026 and back on 25 October."""
    for first, after in (("2026-03-23T09:00", "2026-03-30T09:00"), ("2026-10-19T09:00", "2026-10-26T09:00")):
        begins = local_ns(first)
        times = list_times_between("FREQ=WEEKLY", ZURICH, begins, begins, begins + 8 * DAY_NS)
        assert times == [begins, local_ns(after)]
        assert times[1] - times[0] != 7 * DAY_NS
        assert [in_zone(at, ZURICH)[11:16] for at in times] == ["09:00", "09:00"]
    lab = small()
    begins = local_ns("2026-03-23T09:00")
    name = book(lab, NewTerms(begins=begins, ends=begins + HOUR, user="bo", zone=ZURICH, rule="FREQ=WEEKLY"))
    lab.now = begins
    lab.pump()
    lab.now = begins + HOUR
    lab.pump()
    assert booking(lab, name).next_change == local_ns("2026-03-30T09:00") - LEAD_NS
    lab.now = local_ns("2026-03-30T09:00")
    lab.pump()
    assert booking(lab, name).until == local_ns("2026-03-30T10:00")


def test_an_hour_that_does_not_exist_is_the_next_one() -> None:
    begins = local_ns("2026-03-28T02:30")
    times = list_times_between("FREQ=DAILY", ZURICH, begins, begins, local_ns("2026-03-31T00:00"))
    assert [in_zone(at, ZURICH) for at in times] == [
        "2026-03-28 02:30 CET",
        "2026-03-29 03:30 CEST",
        "2026-03-30 02:30 CEST",
    ]


def test_rules_of_every_kind() -> None:
    begins = local_ns("2026-01-05T09:00")  # a Monday
    for rule, count in [
        ("FREQ=DAILY", 365),
        ("FREQ=WEEKLY;BYDAY=MO,TU,WE,TH,FR", 261),
        ("FREQ=WEEKLY;INTERVAL=2", 26),
        ("FREQ=MONTHLY;BYDAY=1MO", 12),
        ("FREQ=DAILY;COUNT=10", 10),
        ("FREQ=MONTHLY;BYMONTHDAY=5", 12),
        ("FREQ=MONTHLY;BYMONTHDAY=-27", 12),
        ("FREQ=MONTHLY;BYDAY=MO;BYSETPOS=1", 12),
        ("FREQ=YEARLY;BYMONTH=1;BYDAY=1MO", 1),
    ]:
        assert find_rule_fault(rule, ZURICH, begins) == "", rule
        times = list_times_between(rule, ZURICH, begins, begins, local_ns("2027-01-05T09:00"))
        assert abs(len(times) - count) <= 1, rule
    assert "first time" in find_rule_fault("FREQ=WEEKLY;BYDAY=TU", ZURICH, begins)
    assert "characters" in find_rule_fault("FREQ=DAILY;BYMONTH=" + "1," * 200 + "1", ZURICH, begins)


def test_one_time_of_many_falls_out() -> None:
    lab = small()
    name = book(lab, terms(1, 2, rule="FREQ=DAILY", last=START + 3 * DAY_NS))
    second = START + HOUR + DAY_NS
    assert lab.reject(CancelBooking(name, "op", begins=second + 1)).code == "no_time"
    lab.do(CancelBooking(name, "op", "holiday", second))
    begun = []
    for hour in range(0, 24 * 5):
        lab.now = START + hour * HOUR
        lab.pump()
        begun += [lab.now] if lab.state.bookings.now else []
    assert begun == [START + HOUR, START + HOUR + 2 * DAY_NS]
    assert not lab.state.bookings.open, "the last of them is over"
    lab.check_log()


def test_the_time_that_it_is_now_can_fall_out_too() -> None:
    lab = small()
    name = book(lab, terms(1, 2, rule="FREQ=DAILY"))
    lab.now = START + HOUR
    lab.pump()
    lab.do(CancelBooking(name, "op", begins=lab.now))
    assert not lab.state.bookings.now
    lab.pump()
    assert not lab.state.bookings.now
    assert booking(lab, name).next_change == START + HOUR + DAY_NS - LEAD_NS
    lab.check_log()


def test_a_booking_that_was_changed_while_it_was_on() -> None:
    lab = small()
    name = book(lab, terms(1, 3))
    lab.now = START + HOUR
    lab.pump()
    lab.do(ChangeBooking(name, terms(1, 1.5), "op", lab.now))
    lab.pump()
    assert booking(lab, name).until == START + 3 * HOUR // 2
    lab.now = START + 2 * HOUR
    lab.pump()
    assert not lab.state.bookings.open
    lab.check_log()


# -- rights ----------------------------------------------------------------------------------------


def check_denied(lab: Driver, command: Command, actor: str) -> str:
    refusal = lab.reject(command, actor)
    assert isinstance(refusal, Denied), refusal
    return refusal.code


@pytest.mark.parametrize("own", [{"user": "ada"}, {"group": "chemistry"}], ids=["self", "group"])
def test_a_submitter_books_for_oneself_or_the_own_group(own: dict[str, str]) -> None:
    lab = make_shared()
    name = book(lab, terms(1, 2, **own), by="ada", actor="ada")  # type: ignore[arg-type]
    lab.do(ChangeBooking(name, terms(2, 3, **own), "ada", lab.now), "ada")  # type: ignore[arg-type]
    assert check_denied(lab, CancelBooking(name, "bo"), "bo") == "not_yours"
    lab.do(CancelBooking(name, "ada"), "ada")


@pytest.mark.parametrize(
    "what",
    [terms(1, 2, "bo"), terms(1, 2, maintenance=True), terms(1, 2, "ada", rule="FREQ=DAILY")],
    ids=["others", "maintenance", "repeated"],
)
def test_what_only_an_operator_books(what: NewTerms) -> None:
    lab = make_shared()
    assert check_denied(lab, MakeBooking(DEV, what, "ada", lab.now), "ada") == "no_right"
    name = book(lab, what, by="op", actor="op")
    refused = check_denied(lab, ChangeBooking(name, what, "cy", lab.now), "cy")
    assert refused in ("no_right", "not_yours")


def test_nobody_books_in_the_name_of_another() -> None:
    lab = make_shared()
    assert check_denied(lab, MakeBooking(DEV, terms(1, 2, "bo"), "bo", lab.now), "ada") == "not_you"
    lab.do(AddUser("bot", "service"))
    lab.do(GrantRole("user:bot", "submitter", "cell"))
    both = "bot for ada"
    book(lab, terms(1, 2, "ada"), by=both, actor=both)
    assert check_denied(lab, MakeBooking(DEV, terms(3, 4, "bo"), both, lab.now), both) == "no_right"


def test_by_force_only_an_admin_books() -> None:
    lab = make_shared()
    book(lab, terms(1, 3), by="op", actor="op")
    assert (
        check_denied(lab, MakeBooking(DEV, terms(2, 4, "cy"), "op", lab.now, force=True), "op") == "no_right"
    )
    assert lab.reject(MakeBooking(DEV, terms(2, 4, "cy"), "root", lab.now), "root").code == "booked"
    book(lab, terms(2, 4, "cy"), by="root", force=True, actor="root")


def test_an_operator_cancels_what_others_have_booked_and_those_for_whom_it_is_give_it_back() -> None:
    lab = make_shared()
    mine = book(lab, terms(1, 2, "ada"), by="ada", actor="ada")
    lab.do(CancelBooking(mine, "op"), "op")
    given = book(lab, terms(1, 2, "bo"), by="op", actor="op")
    lab.do(CancelBooking(given, "bo"), "bo")


def test_a_submitter_has_a_quota_and_an_operator_has_none() -> None:
    lab = make_shared()
    far = terms(24 * 15, 24 * 15 + 1, "ada")
    assert lab.reject(MakeBooking(DEV, far, "ada", lab.now), "ada").code == "too_far"
    for hour in (1, 30, 60):
        book(lab, terms(hour, hour + 8, "ada"), by="ada", actor="ada")
    refusal = lab.reject(MakeBooking(DEV, terms(90, 91, "ada"), "ada", lab.now), "ada")
    assert refusal.code == "quota"
    assert "25.0 h" in refusal.message
    lab.now = START + 9 * HOUR
    lab.pump()
    book(lab, terms(90, 91, "ada"), by="ada", actor="ada")
    book(lab, terms(24 * 30, 24 * 33, "ada"), by="op", actor="op")


def test_the_policy_says_how_much_whoever_is_no_operator_may_book() -> None:
    lab = make_shared()
    limits = BookingLimits(hours=12.0, total_hours=30.0, days_ahead=30)
    lab.do(ApplyPolicy("d", Policy(bookings=limits)), "root")

    def check_refused(begins: int, ends: int, by: str = "ada") -> Rejection:
        return lab.reject(MakeBooking(DEV, terms(begins, ends, by), by, lab.now), by)

    long = check_refused(1, 14)
    assert (long.code, "lasts 13.0 h" in long.message, "may last at most 12 h" in long.message) == (
        "too_long",
        True,
        True,
    )
    far = check_refused(24 * 30 + 1, 24 * 30 + 2)
    assert (far.code, far.message) == ("too_far", "ada may book 30 days ahead at most.")
    first = book(lab, terms(24 * 30, 24 * 30 + 12, "ada"), by="ada", actor="ada")
    longer = ChangeBooking(first, terms(24 * 30, 24 * 30 + 13, "ada"), "ada", lab.now)
    assert lab.reject(longer, "ada").code == "too_long"
    later = ChangeBooking(first, terms(24 * 31, 24 * 31 + 1, "ada"), "ada", lab.now)
    assert lab.reject(later, "ada").code == "too_far"
    book(lab, terms(1, 13, "ada"), by="ada", actor="ada")
    assert check_refused(20, 27).code == "quota"
    book(lab, terms(20, 26, "ada"), by="ada", actor="ada")
    book(lab, terms(24 * 50, 24 * 52, "ada"), by="op", actor="op")
    lab.do(ApplyPolicy("e", Policy(bookings=BookingLimits(days_ahead=2))), "root")
    assert lab.state.bookings.open[first].ends, "what was booked before stays"
    assert check_refused(24 * 2 + 1, 24 * 2 + 2).code == "too_far"


def test_unknown_users_are_refused_where_users_are_known() -> None:
    assert make_shared().reject(MakeBooking(DEV, terms(1, 2, "eve"), "op", START), "op").code == "no_user"


# -- what may start --------------------------------------------------------------------------------


def test_a_step_that_would_run_into_a_booking_is_not_possible() -> None:
    lab = small()
    book(lab, terms(1, 2))
    short = lab.submit(plan(step("dev", duration_s=3600.0)))
    long = lab.submit(plan(step("dev", duration_s=3601.0)))
    assert lab.code(short) == "", "it ends when the booking begins"
    assert lab.code(long) == "booked_soon"
    assert lab.code(lab.submit(plan(step("dev", duration_s=3601.0)), user="bo")) == ""
    assert lab.code(lab.submit(plan(step("cam", duration_s=3601.0)))) == ""
    assert lab.reject(lab.start_command(long, 0)).code == "booked_soon"
    lab.now = START + HOUR
    assert lab.code(short) == "booked"
    lab.now = START + 2 * HOUR
    assert lab.code(short) == ""


def test_groups_and_maintenance() -> None:
    lab = small()
    lab.do(ApplyShares("d", (Group("chemistry", 1.0, {"ada": Member()}),)))
    book(lab, terms(0, 1, group="chemistry"))
    book(lab, terms(1, 2, maintenance=True))
    ada, bo = lab.submit(plan(step("dev"))), lab.submit(plan(step("dev")), user="bo")
    assert (lab.code(ada), lab.code(bo)) == ("", "booked")
    lab.now = START + HOUR
    assert (lab.code(ada), lab.code(bo)) == ("booked", "booked")
    reset = lab.submit(plan(step("dev", recovers=True)))
    assert lab.code(reset) == "", "what brings a module back goes on"


def test_an_arm_may_carry_out_of_a_booked_module_but_not_into_it_and_not_in_maintenance() -> None:
    lab = small()
    there = lab.submit(plan(step("arm", take("stack", "dev.n1")), step("arm", move("dev.n1", "a"))))
    lab.step(there)
    into = lab.submit(plan(step("arm", take("stack", "dev.n2"))))
    name = book(lab, terms(0, 1))
    assert (lab.code(there, 1), lab.code(into)) == ("", "booked")
    lab.do(CancelBooking(name, "op"))
    book(lab, terms(0, 1, maintenance=True))
    assert (lab.code(there, 1), lab.code(into)) == ("booked", "booked")


def test_what_was_booked_later_by_force_goes_first() -> None:
    lab = small()
    book(lab, terms(0, 4, "bo"))
    book(lab, terms(1, 2, "cy"), force=True)
    bo = lab.submit(plan(step("dev", duration_s=60.0)), user="bo")
    cy = lab.submit(plan(step("dev", duration_s=60.0)), user="cy")
    assert (lab.code(bo), lab.code(cy)) == ("", "booked")
    lab.now = START + HOUR
    assert (lab.code(bo), lab.code(cy)) == ("booked", "")
    lab.now = START + 2 * HOUR
    assert (lab.code(bo), lab.code(cy)) == ("", "booked")


# -- what people are told --------------------------------------------------------------------------


def stand_a_plate(lab: Driver) -> str:
    name = lab.submit(plan(step("arm", take("stack", "dev.n1")), step("arm", move("dev.n1", "a"))))
    lab.step(name)
    return name


def test_what_stands_where_it_is_booked_is_told_ahead_of_time_and_withdrawn_when_it_has_left() -> None:
    lab = small()
    run = stand_a_plate(lab)
    book(lab, terms())
    lab.now = START + HOUR - LEAD_NS
    lab.do(NearBooking("B1", lab.now))
    question = lab.question("booked_place")
    assert "P1 of run R1 at dev.n1" in question.text
    lab.now = START + HOUR
    lab.do(BeginBooking("B1", lab.now))
    assert len(lab.questions("booked_place")) == 1, "not asked twice"
    lab.step(run, 1)
    assert not lab.questions("booked_place")
    lab.check_log()


def test_what_is_theirs_is_in_nobodys_way() -> None:
    lab = small()
    stand_a_plate(lab)
    book(lab, terms(user="ada"))
    lab.now = START + HOUR - LEAD_NS
    lab.do(NearBooking("B1", lab.now))
    assert not lab.questions()


@pytest.mark.parametrize("end", ["done", "cancelled", "over"])
def test_what_overruns_is_told_and_not_interrupted(end: str) -> None:
    lab = small()
    book(lab, terms())
    lab.now = START + HOUR - 10 * MINUTE
    action = lab.start(lab.submit(plan(step("dev", duration_s=300.0))))
    lab.now = START + HOUR
    lab.do(BeginBooking("B1", lab.now))
    assert "It goes on to its end" in lab.question("booked_place").text
    assert action in lab.state.actions.open
    if end == "done":
        lab.finish(action)
    elif end == "cancelled":
        lab.do(CancelBooking("B1", "op"))
    else:
        lab.now = START + 2 * HOUR
        lab.do(EndBooking("B1", lab.now))
    assert not lab.questions("booked_place")
    lab.check_log()


def test_noted_is_an_answer() -> None:
    lab = small()
    stand_a_plate(lab)
    book(lab, terms())
    lab.now = START + HOUR - LEAD_NS
    lab.do(NearBooking("B1", lab.now))
    lab.answer(lab.question("booked_place"), "noted")
    assert not lab.questions()


def test_a_log_is_folded_from_its_events_alone() -> None:
    """As after a kill -9: whatever was decided stands in the log, and nothing is worked out anew."""
    lab = small()
    book(lab, terms(1, 2, rule="FREQ=DAILY", zone=ZURICH))
    book(lab, terms(3, 4, maintenance=True), CELL)
    for hour in range(0, 60):
        lab.now = START + hour * HOUR // 2
        lab.pump()
        lab.keep_picture()
    lab.check_log()
