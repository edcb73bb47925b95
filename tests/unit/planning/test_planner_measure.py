"""What a planner takes for better: first what the lab puts first, then the end of all and of each."""

from __future__ import annotations

import pytest

from labos.core.ids import RunId
from labos.planner.measure import Rated, Score, judge
from labos.planning.virtual import Play

S = 1_000_000_000
ONE, TWO, THREE = RunId("one"), RunId("two"), RunId("three")
ALIKE = {ONE: Rated(0, 0, False), TWO: Rated(0, 0, False)}


def ends(*seconds: float, missed: int = 0) -> Play:
    names = (ONE, TWO, THREE)
    return Play(ends={name: int(at * S) for name, at in zip(names, seconds, strict=False)}, missed=missed)


def score(play: Play, rated: dict[RunId, Rated] = ALIKE) -> Score:
    return judge([play], rated, 0)


def test_a_run_that_ends_sooner_is_better_though_all_ends_as_late() -> None:
    assert score(ends(50, 100)) < score(ends(80, 100))


def test_the_end_of_all_counts_as_much_as_the_mean_of_all_ends() -> None:
    assert score(ends(60, 90)) < score(ends(50, 100))
    assert score(ends(10, 100)) < score(ends(90, 95))


def test_the_end_of_all_may_count_more_often_than_the_mean_of_all_ends() -> None:
    sooner_over, sooner_on_average = ends(85, 90), ends(40, 100)
    assert score(sooner_on_average) < score(sooner_over)
    assert judge([sooner_over], ALIKE, 0, end_weight=4) < judge([sooner_on_average], ALIKE, 0, end_weight=4)


@pytest.mark.parametrize("before", [Rated(1, 0, False), Rated(2, 0, False)])
def test_who_goes_first_is_not_made_to_wait_though_all_would_end_sooner(before: Rated) -> None:
    rated = {ONE: before, TWO: Rated(0, 0, False), THREE: Rated(1, 0, False)}
    assert score(ends(50, 200, 60), rated) < score(ends(55, 100, 60), rated)


def test_a_deadline_of_a_campaign_goes_before_the_end_of_all() -> None:
    rated = {ONE: Rated(0, 60 * S, False), TWO: Rated(0, 0, False)}
    assert score(ends(60, 200), rated) < score(ends(70, 100), rated)
    assert score(ends(60, 100), rated) < score(ends(50, 110), rated), "in time is in time"


def test_due_dates_order_the_runs_of_one_user() -> None:
    due = Rated(0, 0, False, "ada", 60 * S)
    own = {ONE: due, TWO: Rated(0, 0, False, "ada")}
    assert score(ends(60, 90), own) < score(ends(90, 40), own), "it is late only because the other went first"
    other = {ONE: due, TWO: Rated(0, 0, False, "bob")}
    assert score(ends(90, 40), other) < score(ends(60, 90), other), "nobody else waits for it"


def test_of_two_runs_that_are_late_the_one_that_was_due_first_goes_first() -> None:
    rated = {ONE: Rated(0, 0, False, "ada", 10 * S), TWO: Rated(0, 0, False, "ada", 40 * S)}
    assert score(ends(50, 60), rated).avoidable_s == 0.0
    assert score(ends(50, 20), rated).avoidable_s == 20.0


def test_a_window_that_is_kept_goes_before_all_that() -> None:
    assert score(ends(90, 200)) < score(ends(50, 100, missed=1))


def test_of_an_experiment_each_end_counts_as_the_end_of_all() -> None:
    rated = {ONE: Rated(0, 0, True), TWO: Rated(0, 0, False)}
    assert score(ends(40, 100), rated) < score(ends(90, 60), rated)


def test_runs_that_were_submitted_meanwhile_are_not_counted() -> None:
    assert score(ends(50, 100, 999)) == score(ends(50, 100))


def test_of_several_plays_what_is_missed_counts_in_all_and_times_on_average() -> None:
    found = judge([ends(50, 100, missed=1), ends(70, 120, missed=2)], ALIKE, 0)
    assert found.missed == 3
    assert found.cost_s == 110.0 + 85.0


def test_a_gain_that_is_soon_lost_is_none() -> None:
    one, other = score(ends(1000, 1000)), score(ends(1010, 1010))
    assert one.is_better_than(other, 0.0)
    assert not one.is_better_than(other, 0.02)
    assert not one.is_better_than(other, 0.0, least_s=60.0)
    assert not other.is_better_than(one, 0.0)


def test_a_small_gain_of_who_goes_first_is_not_worth_a_great_loss_of_the_others() -> None:
    first = {ONE: Rated(1, 0, False), TWO: Rated(0, 0, False)}
    dear, cheap = score(ends(1000, 9000), first), score(ends(1005, 2000), first)
    assert dear < cheap
    assert cheap.is_better_than(dear, 0.01)


def test_a_window_that_is_kept_is_never_too_small_a_gain() -> None:
    assert score(ends(900, 900)).is_better_than(score(ends(50, 60, missed=1)), 0.01, least_s=60.0)
