"""Times as people say them."""

from __future__ import annotations

from datetime import datetime
from zoneinfo import ZoneInfo

import pytest

from labos.cli._when import find_local_zone, parse_when, rule_of
from labos.errors import BadInput

ZONE = "Europe/Zurich"


def at(text: str) -> int:
    return int(datetime.fromisoformat(text).replace(tzinfo=ZoneInfo(ZONE)).timestamp()) * 10**9


NOW = at("2026-11-25T10:00")  # a Wednesday


@pytest.mark.parametrize(
    ("said", "meant"),
    [
        ("now", "2026-11-25T10:00"),
        ("2026-11-26 09:00", "2026-11-26T09:00"),
        ("2026-11-26T08:00Z", "2026-11-26T09:00"),
        ("2026-11-26", "2026-11-26T00:00"),
        ("tomorrow 9:00", "2026-11-26T09:00"),
        ("Tomorrow", "2026-11-26T00:00"),
        ("today 17:30", "2026-11-25T17:30"),
        ("mon 09:00", "2026-11-30T09:00"),
        ("thursday 09:00", "2026-11-26T09:00"),
        ("wed 12:00", "2026-12-02T12:00"),
        ("17:00", "2026-11-25T17:00"),
        ("09:00", "2026-11-26T09:00"),
        ("+2h", "2026-11-25T12:00"),
        ("+1d30min", "2026-11-26T10:30"),
    ],
)
def test_times(said: str, meant: str) -> None:
    assert parse_when(said, NOW, ZONE) == at(meant)


def test_ends_count_from_the_begin() -> None:
    begin = at("2026-11-30T09:00")
    assert parse_when("+2h", NOW, ZONE, after=begin) == at("2026-11-30T11:00")
    assert parse_when("17:00", NOW, ZONE, after=begin) == at("2026-11-30T17:00")
    assert parse_when("08:00", NOW, ZONE, after=begin) == at("2026-12-01T08:00")


@pytest.mark.parametrize("said", ["", "soon", "25:00", "mo 09:00", "09:61", "+2 parsecs", "mon tue"])
def test_what_is_no_time(said: str) -> None:
    with pytest.raises(BadInput):
        parse_when(said, NOW, ZONE)


def test_how_often() -> None:
    assert rule_of(None, None) == ""
    assert rule_of("week", None) == "FREQ=WEEKLY"
    assert rule_of("2 Weeks", None) == "FREQ=WEEKLY;INTERVAL=2"
    assert rule_of("weekday", None) == "FREQ=WEEKLY;BYDAY=MO,TU,WE,TH,FR"
    assert rule_of(None, "rrule:freq=daily") == "FREQ=DAILY"
    for wrong in (("often", None), ("day", "FREQ=DAILY"), ("0.5 days", None)):
        with pytest.raises(BadInput):
            rule_of(*wrong)


def test_the_time_zone_of_this_computer(monkeypatch: pytest.MonkeyPatch) -> None:
    for said, meant in ((ZONE, ZONE), (f":{ZONE}", ZONE), ("nonsense", "UTC"), ("UTC", "UTC")):
        monkeypatch.setenv("TZ", said)
        assert find_local_zone() == meant
