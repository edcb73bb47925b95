"""Times as people write them."""

from __future__ import annotations

from datetime import timedelta, timezone

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labos.errors import BadInput
from labos.services.times import iso_time, parse_moment, parse_time, show_span, show_time, with_iso_times

NOW = 1_750_000_000_123_456_789
CEST = timezone(timedelta(hours=2))
SECOND = 1_000_000_000


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("-2h", 7200), ("-90s", 90), ("-1d12h", 129600), ("-1.5h", 5400), ("-2h 30m", 9000), ("-5min", 300)],
)
def test_relative_times(text: str, seconds: int) -> None:
    assert parse_time(text, NOW) == NOW - seconds * SECOND


def test_a_time_without_zone_is_local() -> None:
    assert parse_time("2025-06-15T17:06:40", 0, CEST) == 1_750_000_000 * SECOND
    assert parse_time("2025-06-15T15:06:40Z", 0, CEST) == 1_750_000_000 * SECOND
    assert parse_time("2025-06-15T10:06:40-05:00", 0) == 1_750_000_000 * SECOND
    assert parse_time("2025-06-15 17:06", 0, CEST) == 1_749_999_960 * SECOND
    assert parse_time("2025-06-15", 0, CEST) == parse_time("2025-06-14T22:00Z", 0)


def test_without_a_zone_given_the_machines_own_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    import time

    monkeypatch.setenv("TZ", "Etc/GMT+7")
    time.tzset()
    try:
        assert parse_time("2025-06-15T08:06:40", 0) == 1_750_000_000 * SECOND
        assert show_time(1_750_000_000 * SECOND) == "2025-06-15 08:06:40.000-07:00"
    finally:
        monkeypatch.undo()
        time.tzset()


@given(st.integers(0, 2**62))
def test_what_programs_read_is_exact(ns: int) -> None:
    assert parse_time(iso_time(ns), 0) == ns


@pytest.mark.parametrize("text", ["", "yesterday", "-2", "-h", "2025-13-01", "12 o'clock", "99999-01-01"])
def test_what_is_no_time_is_refused_with_examples(text: str) -> None:
    with pytest.raises(BadInput, match="is not a time") as caught:
        parse_time(text, NOW)
    assert "-2h" in caught.value.remedy


def test_a_whole_number_is_a_position() -> None:
    assert parse_moment("42", NOW).position == 42
    assert parse_moment("now", NOW).at_ns == NOW
    assert parse_moment("-1s", NOW).at_ns == NOW - SECOND


def test_spans() -> None:
    shown = [show_span(s) for s in (0.0, 0.254, 9.9, 42.2, 61, 3599.6, 7205, 90000)]
    assert shown == ["0 s", "0.25 s", "9.9 s", "42 s", "1 min 01 s", "1 h 00 min", "2 h 00 min", "1 d 01 h"]
    assert show_time(0) == ""
    assert show_time(NOW, CEST) == "2025-06-15 17:06:40.123+02:00"
    assert parse_time(show_time(NOW, CEST), 0) == NOW // 1_000_000 * 1_000_000


def test_moments_in_plain_data_are_iso_and_foreign_data_is_left() -> None:
    step = {"ended_at": 0, "result": {"at": 3}, "attempts": 1}
    plain = {"submitted_at": SECOND, "steps": [step], "busy": [(0, SECOND)], "since": True, "at": 1.5}
    assert with_iso_times(msgspec.to_builtins(plain)) == {
        "submitted_at": "1970-01-01T00:00:01.000000000Z",
        "steps": [{"ended_at": "", "result": {"at": 3}, "attempts": 1}],
        "busy": [["1970-01-01T00:00:00.000000000Z", "1970-01-01T00:00:01.000000000Z"]],
        "since": True,
        "at": 1.5,
    }
