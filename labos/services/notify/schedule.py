"""Which contact receives a notice, and when: escalation and quiet hours. Pure; times in UTC nanoseconds."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, tzinfo

import msgspec

from labos.services.notify.contacts import Book, Contact, Quiet
from labos.services.notify.notices import KERNEL, Notice

SECOND = 1_000_000_000


class Due(msgspec.Struct, frozen=True):
    """A contact and the time at which it will be notified."""

    contact: str
    level: int
    at: int


def plan(book: Book, notice: Notice, now: int) -> list[Due]:
    """Every message that follows from the notice if nobody answers it.

    Each level is notified a given time after the level before. If a question is not urgent, this time begins
    when the first contact of the level before can be notified; for an urgent one, quiet hours do not delay
    the next level. A notice that asks nothing is sent to the first level that wants its topic. If the kernel
    has stopped, there may be no process left for an escalation: all contacts are notified at once.
    """
    base = now + int(book.module_grace * SECOND) if notice.topic == "modules" else now
    found: list[Due] = []
    for number, level in enumerate(book.levels):
        base += 0 if notice.key == KERNEL else int(level.after * SECOND)
        caring = [name for name in dict.fromkeys(level.notify) if notice.topic in book.contacts[name].about]
        messages = [
            Due(name, number, find_audible_time(book, book.contacts[name], base, urgent=notice.urgent))
            for name in caring
        ]
        found += messages
        if messages and not notice.key:
            break
        if messages and not notice.urgent:
            base = min(due.at for due in messages)
    return found


def find_audible_time(book: Book, contact: Contact, at: int, *, urgent: bool) -> int:
    """The first moment from ``at`` on at which a contact may be notified."""
    quiet = contact.quiet
    if quiet is None or (urgent and quiet.urgent == "pass"):
        return at
    return end_of_quiet(quiet, book.find_zone(contact), at)


def end_of_quiet(quiet: Quiet, zone: tzinfo | None, at: int) -> int:
    """The end of the quiet hours that contain ``at``, else ``at``. ``zone`` None is the time zone of this
    computer."""
    here = datetime.fromtimestamp(at // SECOND, UTC).astimezone(zone)
    minute = here.hour * 60 + here.minute
    over_midnight = quiet.start > quiet.end
    if over_midnight:
        inside = minute >= quiet.start or minute < quiet.end
    else:
        inside = quiet.start <= minute < quiet.end
    if not inside:
        return at
    day = here.date() + timedelta(days=1 if over_midnight and minute >= quiet.start else 0)
    # By local time, also on days on which summer time begins or ends.
    end = datetime(day.year, day.month, day.day, quiet.end // 60, quiet.end % 60, tzinfo=zone)
    return max(int(end.timestamp()) * SECOND, at)
