"""Who hears of a notice, and when."""

from __future__ import annotations

from datetime import datetime
from zoneinfo import ZoneInfo

import pytest

from labos.services.notify import Book, load_contacts
from labos.services.notify.notices import KERNEL, Notice
from labos.services.notify.schedule import end_of_quiet, plan
from labos.spec import parse_source

ZURICH = ZoneInfo("Europe/Zurich")
SECOND = 1_000_000_000


def at(text: str) -> int:
    """Local time in Zurich as nanoseconds."""
    return int(datetime.fromisoformat(text).replace(tzinfo=ZURICH).timestamp()) * SECOND


def book(anna: str = "hold", ben: str = "", grace: str = "1 min") -> Book:
    """Anna is quiet at night; ben, who is told after 10 minutes, only if ``ben`` says so; carl is
    told after 20 more."""
    quiet = 'quiet: {start: "22:00", end: "07:00", urgent: %s}'
    return load_contacts(
        parse_source(
            f"""\
timezone: Europe/Zurich
module_grace: {grace}
contacts:
  anna: {{webhook: "http://a", {quiet % anna}}}
  ben: {{webhook: "http://b"{", " + quiet % ben if ben else ""}}}
  carl: {{webhook: "http://c", about: [interventions, kernel]}}
escalation:
  - notify: anna
  - {{notify: [ben], after: 10 min}}
  - {{notify: [carl], after: 20 min}}
""".replace("notify: anna", "notify: [anna]")
        )
    )


def notice(*, urgent: bool = False, topic: str = "interventions", key: str = "intervention:I1") -> Notice:
    return Notice("e1", 7, 0, topic, key, "title", "text", urgent)


def times(found: Book, told: Notice, now: str) -> dict[str, str]:
    """When each contact is told, by the clock in Zurich."""
    return {
        due.contact: f"{datetime.fromtimestamp(due.at / 1e9, ZURICH):%d %H:%M}"
        for due in plan(found, told, at(now))
    }


def test_by_day_one_after_the_other() -> None:
    told = times(book(), notice(), "2026-05-04T10:00")
    assert told == {"anna": "04 10:00", "ben": "04 10:10", "carl": "04 10:30"}


def test_what_is_not_urgent_waits_for_the_morning_and_so_does_its_escalation() -> None:
    told = times(book(), notice(), "2026-05-04T23:00")
    assert told == {"anna": "05 07:00", "ben": "05 07:10", "carl": "05 07:30"}


def test_what_is_urgent_passes_if_the_contact_says_so() -> None:
    told = times(book("pass", "pass"), notice(urgent=True), "2026-05-04T23:00")
    assert told == {"anna": "04 23:00", "ben": "04 23:10", "carl": "04 23:30"}


def test_what_is_urgent_does_not_wait_for_who_sleeps() -> None:
    told = times(book("hold", "pass"), notice(urgent=True), "2026-05-04T23:00")
    assert told == {"anna": "05 07:00", "ben": "04 23:10", "carl": "04 23:30"}


def test_what_asks_nothing_goes_no_further() -> None:
    told = times(book(), notice(topic="windows", key=""), "2026-05-04T10:00")
    assert told == {"anna": "04 10:00"}


def test_who_does_not_care_is_not_told() -> None:
    told = times(book(), notice(topic="modules", key="module:c/m"), "2026-05-04T10:00")
    assert told == {"anna": "04 10:01", "ben": "04 10:11"}


def test_when_the_kernel_has_stopped_everybody_is_told_at_once() -> None:
    told = times(book("pass"), notice(urgent=True, topic="kernel", key=KERNEL), "2026-05-04T23:00")
    assert told == {"anna": "04 23:00", "ben": "04 23:00", "carl": "04 23:00"}


@pytest.mark.parametrize(
    ("now", "end"),
    [
        ("2026-05-04T21:59:59", "2026-05-04T21:59:59"),
        ("2026-05-04T22:00", "2026-05-05T07:00"),
        ("2026-05-05T06:59:59", "2026-05-05T07:00"),
        ("2026-05-05T07:00", "2026-05-05T07:00"),
        ("2026-03-28T23:00", "2026-03-29T07:00"),  # summer time begins in that night
        ("2026-10-24T23:00", "2026-10-25T07:00"),  # and ends in this one
    ],
)
def test_quiet_hours_over_midnight(now: str, end: str) -> None:
    quiet = book().contacts["anna"].quiet
    assert quiet is not None
    assert end_of_quiet(quiet, ZURICH, at(now)) == at(end)


def test_quiet_hours_of_one_day() -> None:
    found = load_contacts(
        parse_source('contacts:\n  a: {webhook: "http://a", quiet: {start: "12:00", end: "13:30"}}\n')
    )
    quiet = found.contacts["a"].quiet
    assert quiet is not None
    assert end_of_quiet(quiet, ZURICH, at("2026-05-04T12:30")) == at("2026-05-04T13:30")
    assert end_of_quiet(quiet, ZURICH, at("2026-05-04T14:00")) == at("2026-05-04T14:00")
