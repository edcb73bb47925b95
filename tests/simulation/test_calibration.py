"""Forecasts of a simulated lab whose motions scatter are about what comes (figures: docs/forecast.md)."""

from __future__ import annotations

import pytest

from tests.simulation.calibration import (
    LEVELS,
    days,
    draw_figure,
    figures,
    hear,
    keep_undisturbed,
    learn,
    log_of,
    misses_with_true_durations,
    reliability,
    reliability_drawing,
    table,
)


def test_few_runs_end_about_when_they_were_expected() -> None:
    records = log_of(4, 1, batches=True)
    (miss_s,) = misses_with_true_durations(records)
    assert abs(miss_s) < 5.0, "who knows the durations knows the end: the kernel does what was foreseen"
    heard = hear(records)
    found = learn([heard])
    assert len(found) == 4
    assert len(keep_undisturbed(found)) == 1
    ends = figures(found, "ends")
    assert ends.count == 4
    assert ends.part < 0.1, "the middle error is small beside the time that was foreseen"
    assert draw_figure(found, "usual").startswith("<svg")
    assert table({"few": (found, "usual")}).count("\n") == 3
    parts = reliability([heard], "usual")
    assert parts == sorted(parts), "a range that is to hold more holds no less"
    assert reliability_drawing({"few": parts}).count("<circle") == len(LEVELS)


@pytest.mark.full
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("batches", [False, True])
def test_eight_hundred_forecasts_hold_what_they_say(batches: bool) -> None:
    """So many, because only a quarter ends before anybody else comes: with 50 of those, chance decides."""
    found = learn(days(800, 101, batches=batches))
    ends = figures(found, "ends")
    assert ends.count >= 760
    assert 0.75 <= ends.covered <= 0.85, "four of five, as things usually go"
    alone = figures(keep_undisturbed(found), "ends", "alone")
    assert 0.75 <= alone.covered <= 0.85, (
        "four of five of those after which nobody came, of whom that is told"
    )
    assert alone.part < 0.06
    if not batches:  # in batches the error is that of the runs that nobody knows yet
        assert ends.part < 0.06
