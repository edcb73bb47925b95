"""Who hears of a notice, and when: escalation and quiet hours. Pure; times in UTC nanoseconds."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, tzinfo

import msgspec

from labos.services.notify.contacts import Book, Contact, Quiet
from labos.services.notify.notices import KERNEL, Notice

SECOND = 1_000_000_000


class Due(msgspec.Struct, frozen=True):
    """A contact is to be told at a time."""

    contact: str
    level: int
    at: int


def plan(book: Book, notice: Notice, now: int) -> list[Due]:
    """Every message that the notice will take if nobody answers it.

    A question that is not urgent goes to the next level so long after the first contact of the
    one before could hear it; an urgent one does not wait for anybody's morning. What asks nothing
    is told to the first level that cares. When the kernel has stopped, nobody may be left to
    escalate: everybody is told at once.
    """
    base = now + int(book.module_grace * SECOND) if notice.topic == "modules" else now
    found: list[Due] = []
    for number, level in enumerate(book.levels):
        base += 0 if notice.key == KERNEL else int(level.after * SECOND)
        caring = [name for name in dict.fromkeys(level.notify) if notice.topic in book.contacts[name].about]
        told = [
            Due(name, number, find_audible_time(book, book.contacts[name], base, urgent=notice.urgent))
            for name in caring
        ]
        found += told
        if told and not notice.key:
            break
        if told and not notice.urgent:
            base = min(due.at for due in told)
    return found


def find_audible_time(book: Book, contact: Contact, at: int, *, urgent: bool) -> int:
    """The first moment from ``at`` on at which a contact may be told."""
    quiet = contact.quiet
    if quiet is None or (urgent and quiet.urgent == "pass"):
        return at
    return end_of_quiet(quiet, book.find_zone(contact), at)


def end_of_quiet(quiet: Quiet, zone: tzinfo | None, at: int) -> int:
    """The end of the quiet hours that ``at`` falls into, else ``at``. ``zone`` None is the
    machine's."""
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
    # By the clock on the wall, also where summer time begins or ends in between.
    end = datetime(day.year, day.month, day.day, quiet.end // 60, quiet.end % 60, tzinfo=zone)
    return max(int(end.timestamp()) * SECOND, at)
