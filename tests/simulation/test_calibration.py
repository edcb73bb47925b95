"""Forecasts of a simulated lab whose motions scatter are about what comes (figures: docs/forecast.md)."""

from __future__ import annotations

import pytest

from labos.planning.durations import Durations
from tests.simulation.calibration import (
    cases,
    days,
    drawing,
    figures,
    list_known,
    log_of,
    misses_with_true_durations,
    table,
)


def test_few_runs_end_about_when_they_were_expected() -> None:
    records = log_of(4, 1, batches=True)
    (miss_s,) = misses_with_true_durations(records)
    assert abs(miss_s) < 5.0, "who knows the durations knows the end: the kernel does what was foreseen"
    found = list(cases(records, Durations(), steps=100))
    assert len(found) == 4
    ends = figures(found, "ends")
    assert ends.count == 4
    assert ends.part < 0.1, "the middle error is small beside the time that was foreseen"
    assert drawing(found).startswith("<svg")
    assert table({"few": found}).count("\n") == 3


@pytest.mark.full
@pytest.mark.timeout(1800)
def test_two_hundred_forecasts_hold_what_they_say() -> None:
    found = days(200, 1, batches=False)
    ends = figures(found, "ends")
    assert ends.count >= 190
    assert ends.part < 0.05
    assert figures(list_known(found), "ends").covered >= 0.7, (
        "where nobody came after, four of five ranges hold"
    )
