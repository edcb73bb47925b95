"""``labos bookings`` and ``labos calendar``: bookings as a list, as a week or for calendar programs."""

from __future__ import annotations

import click

from labos.cli._complete import make_completer
from labos.cli._options import Asker, lab_and_json
from labos.cli._out import end_with_json, show_lines

DAYS = 7


@click.command("bookings", short_help="List bookings.")
@click.argument("target", required=False, default="", shell_complete=make_completer("module"))
@lab_and_json
def bookings(target: str, asker: Asker) -> None:
    """List current and future bookings, each with its next time: all, or those of TARGET, a module or a
    workcell.

    \b
    labos bookings
    labos bookings ot2_pcr_alpha
    """
    from labos.cli._bookings import show_bookings

    with asker.lab() as client:
        found = client.bookings(target)
    end_with_json(found)
    show_bookings(found)


@click.command("calendar", short_help="Show the bookings of a week.")
@click.argument(
    "target", required=False, default="", metavar="[MODULE|WORKCELL]", shell_complete=make_completer("module")
)
@click.option("--week", "day", metavar="DAY", help="The week of this day; the present week if not given.")
@click.option(
    "--days", type=click.IntRange(1, 60), default=DAYS, show_default=True, help="The number of days to show."
)
@click.option("--zone", metavar="NAME", help="The time zone; this computer's if not given.")
@click.option("--ical", is_flag=True, help="Print all bookings as iCalendar, for calendar programs.")
@lab_and_json
def calendar(target: str, day: str | None, days: int, zone: str | None, ical: bool, asker: Asker) -> None:
    """Show the bookings of a week from Monday on: one bar of 24 hours for each (#: booked, m: maintenance).

    \b
    labos calendar
    labos calendar ot2_pcr_alpha --week 2026-12-01
    labos calendar --ical > lab.ics
    """
    from datetime import datetime, timedelta

    from labos.cli._bookings import list_week
    from labos.cli._query import now_ns
    from labos.cli._when import expect_zone, parse_when
    from labos.core.recurrence import SECOND_NS, find_zone

    where, now = expect_zone(zone), now_ns()
    with asker.lab() as client:
        if ical:
            click.echo(client.calendar_file(target).decode(), nl=False)
            return
        meant = datetime.fromtimestamp(
            (parse_when(day, now, where) if day else now) // SECOND_NS, find_zone(where)
        )
        monday = (meant - timedelta(days=meant.weekday())).replace(hour=0, minute=0, second=0)
        end = monday + timedelta(days=days)
        since, until = (int(at.timestamp()) * SECOND_NS for at in (monday, end))
        found = client.calendar(since, until, target)
    end_with_json(found)
    show_lines(list_week(found["times"], monday, days, where))
