"""A lab that is carried on in virtual time does what the lab itself then does."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from labos.core.campaigns import Terms
from labos.core.decide import Rejection
from labos.core.decide.bookings import MakeBooking, NewTerms
from labos.core.decide.campaigns import SubmitCampaign
from labos.core.decide.runs import SubmitRun
from labos.core.ids import RunId
from labos.core.runs import RunCompleted, RunStarted
from labos.core.state import encode_picture, from_picture
from labos.planning.hindsight import ENOUGH, Hindsight, PastForecast
from labos.planning.lab_forecast import ForecastRequest, forecast_lab
from labos.planning.virtual import MOST_RUNS, Play, VirtualLab, keep_first
from tests.simulation.clocked import Instance, Life
from tests.support.bench import (
    CELL,
    SECOND,
    Driver,
    consumes,
    module,
    move,
    needs,
    plan,
    station,
    step,
    take,
    workcell,
)

HOUR = 3600 * SECOND


def carry_on(lab: Driver) -> Play:
    """The play with the nominal durations, which leaves the lab as it is."""
    before = encode_picture(lab.state)
    told = VirtualLab(from_picture(before), lab.now, lambda _, step: int(step.duration_s * SECOND)).go_on()
    assert encode_picture(lab.state) == before
    return told


def goes_on(life: Life) -> None:
    """What the lab then does."""
    lab = life.lab
    for _ in range(20_000):
        life.finish_due()
        lab.pump()
        at = life.next_time(lab.scheduler.find_next_deadline(lab.state))
        if at is None:
            return
        lab.now = at
    raise AssertionError(lab.describe_stuck())


def times(lab: Driver, kind: type) -> dict[str, int]:
    return {entry.event.run: entry.at for entry in lab.log if isinstance(entry.event, kind)}


@pytest.mark.parametrize("seed", range(25))
def test_with_the_same_durations_a_forecast_is_what_comes(seed: int) -> None:
    instance = Instance(seed)
    follow = {order.behind for order in instance.orders}
    instance.orders = [
        replace(order, after_s=0.0)
        for order in instance.orders
        if not order.behind and order.name not in follow
    ]
    life = Life(instance)
    life.submit_due()
    told = carry_on(life.lab)
    goes_on(life)
    assert told.starts == times(life.lab, RunStarted)
    assert told.ends == times(life.lab, RunCompleted)
    assert not told.stays
    assert not told.failed


# -- a small lab -----------------------------------------------------------------------------------


def small(plates: int = 40, ink: float = 100.0) -> Driver:
    cell = workcell(
        [module("arm"), module("dev", levels={"ink": 100.0}), module("hands")],
        [
            station("stack", "stack", 40),
            station("dev.nest", claim=True),
            station("trash", "waste", 99),
        ],
    )
    lab = Driver(cell)
    lab.stock("stack", plates)
    lab.level("dev", "ink", ink)
    return lab


PRINT = plan(
    step("arm", take("stack", "dev.nest"), duration_s=10.0),
    step("dev", needs("dev.nest"), consumes("ink", 10.0), duration_s=100.0, action="print"),
    step("arm", move("dev.nest", "trash"), duration_s=10.0),
    name="print",
)


def make_request(lab: Driver, **more: object) -> ForecastRequest:
    return ForecastRequest(encode_picture(lab.state), lab.now, **more)  # type: ignore[arg-type]


def test_what_is_used_up_calls_a_person_when_the_first_run_needs_it() -> None:
    lab = small(ink=25.0)
    for _ in range(4):
        lab.submit(PRINT)
    told = forecast_lab(make_request(lab))
    assert [run.ends is None for run in told.runs] == [False, False, True, True]
    assert "ink" in told.runs[2].waits
    (touch,) = told.touches
    assert "ink" in touch.why
    assert "labos replenish" in touch.remedy
    assert not touch.planned
    second = told.runs[1].ends
    assert second is not None
    assert abs(touch.at.expected_at - second.expected_at) < 130 * SECOND


def test_a_step_by_hand_is_a_planned_touch_and_goes_on() -> None:
    lab = small()
    behind = (replace(each, after=(), key="") for each in PRINT.steps)
    by_hand = plan(step("hands", by_person=True, duration_s=60.0), *behind, name="by hand")
    lab.submit(by_hand)
    told = forecast_lab(make_request(lab))
    (touch,) = told.touches
    assert touch.planned
    assert touch.at.expected_at == lab.now
    assert touch.run == told.runs[0].run
    assert told.runs[0].ends is not None


def test_a_waste_that_fills_and_a_stack_that_empties_are_told() -> None:
    lab = small(plates=1)
    for _ in range(2):
        lab.submit(PRINT)
    told = forecast_lab(make_request(lab))
    assert "the stack stack is empty" in [touch.why for touch in told.touches]
    assert told.runs[0].ends is not None
    assert told.runs[1].starts is None


def test_nothing_runs_into_a_booking() -> None:
    lab = small()
    begins = lab.now + 100 * SECOND
    lab.do(MakeBooking(f"{CELL}/dev", NewTerms(begins=begins, ends=begins + HOUR, user="bo"), "bo", lab.now))
    lab.submit(PRINT, user="ada")
    told = forecast_lab(make_request(lab, new=SubmitRun(PRINT, "bo"), actor="labos"))
    ada, bo = (next(run for run in told.runs if run.user == user) for user in ("ada", "bo"))
    assert ada.starts is not None
    assert ada.starts.expected_at >= begins + HOUR
    assert bo.starts is not None
    assert bo.starts.expected_at <= begins


def test_a_booking_of_every_day_is_not_followed_for_ever() -> None:
    lab = small(plates=0)
    begins = lab.now + HOUR
    terms = NewTerms(begins=begins, ends=begins + HOUR, user="bo", rule="FREQ=DAILY")
    lab.do(MakeBooking(f"{CELL}/dev", terms, "bo", lab.now))
    lab.submit(PRINT, user="ada")
    told = forecast_lab(make_request(lab))
    assert told.runs[0].ends is None
    assert told.touches


def test_a_run_that_is_long_is_waited_for_however_long_it_is() -> None:
    lab = small()
    day_s = 24 * 3600.0
    lab.submit(plan(step("dev", duration_s=50 * day_s), step("arm", duration_s=1.0), name="long"))
    told = carry_on(lab)
    assert told.ends == {"R1": lab.now + int((50 * day_s + 1.0) * SECOND)}


def test_whoever_goes_first_delays_the_others() -> None:
    lab = small()
    for _ in range(3):
        lab.submit(PRINT)
    before = encode_picture(lab.state)
    told = forecast_lab(make_request(lab, new=SubmitRun(PRINT, "bo", priority=5), actor="labos"))
    assert encode_picture(lab.state) == before
    assert len(told.new) == 1
    assert {delay.run: delay.by_s for delay in told.delays} == dict.fromkeys(("R1", "R2", "R3"), 120.0)
    last = forecast_lab(make_request(lab, new=SubmitRun(PRINT, "ada"), actor="labos"))
    assert last.delays == []


def test_rows_of_a_campaign_are_let_in_as_there_is_room_and_a_deadline_is_judged() -> None:
    lab = small()
    terms = Terms(deadline=lab.now + 1000 * SECOND)
    campaign = SubmitCampaign("screen", "ada", "print", CELL, 10, "t", "d", terms)
    told = forecast_lab(make_request(lab, new=campaign, new_rows=[(PRINT,)], actor="labos"))
    (found,) = told.campaigns
    assert (found.rows_left, found.rows_forecast, len(told.new)) == (10, 10, 10)
    assert found.ends is not None
    assert abs(found.ends.expected_at - lab.now - 1200 * SECOND) <= 200 * SECOND
    assert told.conflicts == ["The deadline would be missed."]


def test_of_long_campaigns_the_end_is_reckoned_by_their_rate() -> None:
    lab = small(plates=40, ink=100.0)
    free = plan(step("dev", duration_s=100.0), name="wait")
    campaign = SubmitCampaign("long", "ada", "wait", CELL, 1000, "t", "d")
    told = forecast_lab(make_request(lab, new=campaign, new_rows=[(free,)], actor="labos", most_runs=20))
    (found,) = told.campaigns
    assert (found.rows_left, found.rows_forecast) == (1000, 20)
    assert found.ends is not None
    assert found.ends.expected_at - lab.now == pytest.approx(100_000 * SECOND, rel=0.03)


def test_what_is_refused_is_told() -> None:
    lab = small()
    told = forecast_lab(
        make_request(lab, new=SubmitCampaign("none", "ada", "print", CELL, 0, "t", "d"), actor="labos")
    )
    assert "no rows" in told.refusal


def test_each_run_has_a_range_as_wide_as_earlier_forecasts_were_off() -> None:
    lab = small()
    for _ in range(3):
        lab.submit(PRINT)
    past = [
        PastForecast(
            RunId(f"P{n}"), 0, (), 0, HOUR, told := Hindsight().expect("ends", HOUR, 0), told, 1, n * HOUR, 1
        )
        for n in (2, 3, 4) * ENOUGH
    ]
    told = forecast_lab(make_request(lab, hindsight=Hindsight(ended=past)))
    assert told.learned_from == len(past)
    for number, run in enumerate(told.runs, 1):
        assert run.starts is not None
        assert run.ends is not None
        assert run.ends_alone is not None
        takes = number * 120 * SECOND
        assert run.ends.earliest_at == lab.now + 2 * takes
        assert run.ends.latest_at == lab.now + 4 * takes
        assert run.ends_alone.latest_at < lab.now + 2 * takes, "others were the reason, each time"


def test_the_same_question_has_the_same_answer() -> None:
    lab = small()
    for _ in range(3):
        lab.submit(PRINT)
    assert forecast_lab(make_request(lab)) == forecast_lab(make_request(lab))


def test_of_ten_thousand_runs_that_wait_a_bounded_part_is_looked_at() -> None:
    lab = small()
    lab.careful = False
    for number in range(10_000):
        lab.submit(PRINT, user="greedy" if number < 9_990 else "late")
    state = from_picture(encode_picture(lab.state))
    assert keep_first(state) == 10_000 - MOST_RUNS
    assert sum(run.user == "late" for run in state.runs.queued.values()) == 10, "each user has a turn"
    told = VirtualLab(state, lab.now, lambda _, step: int(step.duration_s * SECOND), most_steps=20).go_on()
    assert told.cut
    assert told.steps == 20


def test_a_rejected_row_is_no_reason_to_fail() -> None:
    lab = small()
    virtual = VirtualLab(from_picture(encode_picture(lab.state)), lab.now, lambda *_: SECOND)
    assert isinstance(virtual.submit(SubmitRun(replace(PRINT, workcell="other"), "ada"), "labos"), Rejection)
