"""``labos book``, ``labos bookings`` and ``labos calendar`` with a lab that runs; its calendar over HTTP."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import httpx
import pytest
from icalendar import Calendar

from labos.bootstrap import LabThread, descriptions
from labos.cli.app import main
from labos.client import LabClient
from labos.client._lab import API
from labos.errors import NotFound, Refused
from labos.settings import Settings
from labos.spec import parse_workcell
from tests.integration.http.signed import client_of, lab_with_users, token_of
from tests.support.lab_process import until

CELL = """
labos: 1
name: corner
modules:
  - {name: sealer, model: A4S_sealer, resources: {foil: 400}}
  - {name: reader, model: Hidex}
"""
ZONE = "Europe/Zurich"
Say = Callable[..., str]


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    """Its nodes run."""
    settings = Settings.make(tmp_path_factory.mktemp("lab"), speed=5000.0, simulate=True)
    with LabThread(settings, [parse_workcell(CELL, descriptions())], nodes="processes") as running:
        yield running


@pytest.fixture
def say(lab: LabThread, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[Say]:
    """Runs ``labos`` with these words; at the end nothing is booked any more."""
    monkeypatch.setenv("LABOS_HOME", str(lab.settings.home))
    monkeypatch.setenv("TZ", ZONE)

    def say_(*words: str, user: str = "op", fails: bool = False) -> str:
        monkeypatch.setenv("LABOS_USER", user)
        capsys.readouterr()
        code = main(list(words))
        told = capsys.readouterr()
        assert (code != 0) == fails, told
        return told.err if fails else told.out

    yield say_
    with LabClient(lab.url) as client:
        for booking in client.bookings():
            client.cancel_booking(booking["id"], "op")


def test_a_booking_from_the_command_line_to_the_scheduler_and_back(lab: LabThread, say: Say) -> None:
    hour = ("--from", "now", "--to", "+1h")
    told = json.loads(say("book", "reader", *hour, "--for", "bo", "--why", "course", "--json"))
    name = told["id"]
    assert (told["target"], told["user"], told["why"]) == ("corner/reader", "bo", "course")
    assert told["zone"] == ZONE
    assert "reader  bo" in say("bookings")
    with LabClient(lab.url) as client:
        waits = client.do("reader", "close_lid", user="ada")
        goes = client.do("reader", "close_lid", user="bo")
        assert client.wait(goes, timeout_s=60).status == "completed"
        explained = " ".join(say("explain", waits).split())
        assert f"reader is booked for bo until {told['ends_at'][:8]}" in explained
        assert f"({name})" in explained
        assert f"labos book cancel {name}" in explained
        assert "is cancelled" in say("book", "cancel", name)
        assert client.wait(waits, timeout_s=60).status == "completed"


def test_a_booking_ends_by_itself_and_who_waits_goes_on(lab: LabThread, say: Say) -> None:
    say("book", "corner", "--from", "now", "--to", "+2s", "--maintenance")
    with LabClient(lab.url) as client:
        assert client.wait(client.do("reader", "close_lid", user="ada"), timeout_s=60).status == "completed"
        assert client.bookings() == []
    log = say("log", "--type", "booking")
    assert "op booked corner for maintenance from" in log
    assert "is over, and is not repeated" in log


def test_overlaps_are_refused_by_name(say: Say) -> None:
    say("book", "reader", "--from", "tomorrow 09:00", "--to", "12:00", "--for", "ada")
    refusal = say("book", "reader", "--from", "tomorrow 11:00", "--to", "+2h", user="bo", fails=True)
    assert "reader is booked for ada from" in refusal
    assert "ask op" in refusal
    again = ("book", "corner", "--from", "tomorrow 11:00", "--to", "13:00", "--maintenance")
    assert json.loads(say(*again, "--force", "--json"))["over"]


def test_a_week_in_80_columns(say: Say) -> None:
    days = ("--from", "2027-03-22 09:00", "--to", "12:30", "--every", "weekday")
    one = json.loads(say("book", "reader", *days, "--for", "chemistry-of-long-names", "--json"))["id"]
    night = ("--from", "2027-03-25 22:00", "--to", "+4h")
    two = json.loads(say("book", "corner", *night, "--maintenance", "--json"))["id"]
    lines = say("calendar", "--week", "2027-03-24").splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[0] == "2027 week 12, Europe/Zurich 0     6     12    18"
    assert lines[1] == f"Mon 22 Mar reader           .........####........... 09:00-12:30 {one} chemistry-of"
    assert lines[4].startswith("Thu 25 Mar reader           .........####....")
    assert lines[5:7] == [
        f"           corner           ......................mm 22:00-24:00 {two} maintenance",
        f"Fri 26 Mar corner           mm...................... 00:00-02:00 {two} maintenance",
    ]
    assert lines[-2:] == ["Sat 27 Mar -", "Sun 28 Mar -"]
    assert len(json.loads(say("calendar", "--week", "2027-03-24", "--json"))["times"]) == 6


def test_repeated_bookings_keep_their_hour_over_a_change_of_clocks(lab: LabThread, say: Say) -> None:
    """Switzerland goes to summer time on 28 March 2027."""
    first = ("--from", "2027-03-25 09:00", "--to", "10:00", "--every", "week")
    name = json.loads(say("book", "reader", *first, "--for", "ada", "--json"))["id"]
    calendar = say("calendar", "--week", "2027-04-01")
    assert "Thu 01 Apr reader           .........#.............. 09:00-10:00" in calendar
    skip = ("book", "cancel", name, "--on", "2027-04-01")
    say(*skip, "--why", "holiday")
    assert "Thu 01 Apr -" in say("calendar", "--week", "2027-04-01")
    assert "has no time that begins on 2027-04-01" in say(*skip, fails=True)

    parsed = Calendar.from_ical(say("calendar", "--ical", "reader"))
    (event,) = parsed.walk("VEVENT")
    assert event["UID"].startswith(f"{name}@")
    assert event["RRULE"].to_ical() == b"FREQ=WEEKLY"
    assert event["DTSTART"].dt == datetime(2027, 3, 25, 9, tzinfo=ZoneInfo(ZONE))
    assert event["EXDATE"].dts[0].dt == datetime(2027, 4, 1, 9, tzinfo=ZoneInfo(ZONE))
    assert [zone["TZID"] for zone in parsed.walk("VTIMEZONE")] == [ZONE]


def test_a_booking_is_changed_step_by_step(lab: LabThread, say: Say) -> None:
    monday = ("--from", "mon 09:00", "--to", "12:00", "--for", "user:ada")
    name = json.loads(say("book", "reader", *monday, "--json"))["id"]
    with LabClient(lab.url) as client:
        before = client.booking(name)
        say("book", "change", name, "--from", "mon 10:00")
        after = client.booking(name)
        assert after["ends_at"] - after["begins_at"] == 3 * 3600 * 10**9, "its end has moved along"
        assert after["begins_at"] == before["begins_at"] + 3600 * 10**9
        say("book", "change", name, "--to", "15:00", "--for", "bo", "--why", "swapped")
        after = client.booking(name)
        assert (after["user"], after["why"]) == ("bo", "swapped")
        assert after["ends_at"] - after["begins_at"] == 5 * 3600 * 10**9
        say("book", "change", name, "--maintenance")
        assert client.booking(name)["maintenance"]
        say("book", "change", name, "--every", "2 weeks", "--until", "2030-01-01")
        assert client.booking(name)["rule"] == "FREQ=WEEKLY;INTERVAL=2"
        assert f"{name}  reader" in say("book", "show", name)
        assert "reader" in say("bookings", "corner")
        say("book", "cancel", name)
        with pytest.raises(NotFound):
            client.booking(name)
        with pytest.raises(NotFound):
            client.bookings("nothing")


HOUR = ("book", "reader", "--from", "now", "--to", "+1h")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("book", "reader"), "has no start or no end"),
        (("book", "raeder", "--from", "now", "--to", "+1h"), "raeder"),
        (("book", "reader", "--from", "soon", "--to", "+1h"), "tomorrow 09:00"),
        ((*HOUR, "--zone", "Mars/Olympus"), "Europe/Zurich"),
        ((*HOUR, "--every", "blue moon"), "2 weeks"),
        ((*HOUR, "--every", "day", "--rule", "FREQ=DAILY"), "Leave one"),
        ((*HOUR, "--rule", "FREQ=HOURLY"), "FREQ="),
        ((*HOUR, "--for", "group:none"), "no group 'none'"),
        ((*HOUR, "--for", "ada", "--maintenance"), "cannot be for a group or a user"),
        (("book", "cancel", "B99"), "B99"),
        (("calendar", "nothing"), "nothing"),
    ],
)
def test_what_is_wrong_is_said_with_a_remedy(say: Say, words: tuple[str, ...], told: str) -> None:
    assert told in say(*words, fails=True)


def test_a_run_that_would_never_have_room_is_warned_about(lab: LabThread, say: Say) -> None:
    say("book", "reader", "--from", "now", "--to", "+22h", "--for", "bo", "--every", "day")
    again = ("--from", "+21h", "--to", "+5h", "--for", "bo", "--every", "day")
    say("book", "reader", *again, "--force")
    with LabClient(lab.url) as client:
        run = client.do("reader", "close_lid", user="ada")
        assert any("leave no free time of" in warning for warning in client.warnings), client.warnings
        assert "leave no free time of" in say("explain", run)
        client.cancel(run, "ada")


def test_who_may_book_over_http_and_a_link_for_calendar_programs(tmp_path: Path) -> None:
    with lab_with_users(tmp_path) as lab:
        ada, bob = token_of(tmp_path, "ada"), token_of(tmp_path, "bob")
        body = {"target": "hidex", "begins_at": 4_000_000_000 * 10**9, "ends_at": 4_000_003_600 * 10**9}
        with client_of(lab, bob) as http:
            assert http.post("/bookings", json={**body, "whom": "ada"}).status_code == 403
            far = http.post("/bookings", json=body).json()
            assert far["code"] == "refused"
            assert "14 days ahead" in far["title"] + far.get("detail", "")
        with LabClient(lab.url, token=ada) as client:
            made = client.book("hidex", body["begins_at"], body["ends_at"], "somebody", whom="bob")
            assert (made["by"], made["user"]) == ("ada", "bob")
        with LabClient(lab.url, token=bob) as client:
            client.cancel_booking(made["id"], "bob")
            with pytest.raises((NotFound, Refused)):
                client.cancel_booking(made["id"], "bob")
        look = token_of(tmp_path, "bob", scope="viewer")
        link = f"{lab.url}{API}/calendar.ics"
        assert httpx.get(link).status_code == 401
        assert httpx.get(link, params={"token": look}).headers["content-type"].startswith("text/calendar")
        assert httpx.get(link, params={"token": bob}).status_code == 403, "it could do more than look"
        key = (tmp_path / "lab" / "home.key").read_text().strip()
        assert httpx.get(link, params={"token": key}).status_code == 401
        assert httpx.get(f"{lab.url}{API}/bookings", params={"token": look}).status_code in (400, 401)


def test_metrics_count_bookings(lab: LabThread, say: Say) -> None:
    say("book", "reader", "--from", "now", "--to", "+1h")
    say("book", "reader", "--from", "+2h", "--to", "+1h")

    def are_counted() -> Any:
        text = httpx.get(f"{lab.url}/metrics").text
        return 'labos_bookings{when="now"} 1' in text and 'labos_bookings{when="later"} 1' in text

    until(are_counted, "both are counted")
