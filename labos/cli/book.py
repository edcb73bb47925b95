"""``labos book``: reserves a module or a workcell for a user or a group, for a period."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from labos.cli._bookings import describe_booking, show_bookings
from labos.cli._complete import make_completer
from labos.cli._group import Suggesting
from labos.cli._options import Asker, asker_options, lab_and_json, options_together
from labos.cli._out import end_with_json, report_done
from labos.cli._when import expect_zone, parse_when, rule_of
from labos.core.recurrence import DAY_NS
from labos.errors import BadInput

_booking = click.argument("booking", metavar="BOOKING")
_from = click.option("--from", "begins", metavar="TIME", help="The start: 'tomorrow 09:00', 'mon 9:00'.")
_to = click.option("--to", "ends", metavar="TIME", help="The end: 17:00, +2h.")
_for = click.option("--for", "whom", metavar="NAME", help="For this group or user; you if not given.")
_maintenance = click.option("--maintenance", is_flag=True, help="Book for maintenance: no runs start.")
_every = click.option("--every", metavar="TIME", help="Repeat it every day, week, weekday, month, '2 weeks'.")
_rule = click.option(
    "--rule", metavar="RULE", help="Repeat it by a rule of iCalendar: FREQ=WEEKLY;BYDAY=MO,TH."
)
_last = click.option("--until", "last", metavar="TIME", help="The latest time of a repetition.")
_zone = click.option(
    "--zone", metavar="NAME", help="The time zone of these times; this computer's if not given."
)
_force = click.option("--force", is_flag=True, help="Book even if others have booked; for admins.")
_why = click.option("--why", metavar="TEXT", help="The reason.")


_booking_options = options_together(
    *(_from, _to, _for, _maintenance, _every, _rule, _last, _zone, _why, _force), asker_options
)
"""For whom and when: the options of ``add`` and ``change``."""


class _Booking(Suggesting):
    """An argument that is not a command is the target of a booking: ``labos book ot2``."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and not args[0].startswith("-") and args[0] not in self.commands:
            args = ["add", *args]
        return super().resolve_command(ctx, args)


@click.group("book", cls=_Booking, short_help="Book a module or a workcell for a period of time.")
def command() -> None:
    """Book a module or a workcell: for a group, for a user, or for maintenance.

    Runs of other users do not start steps that would still be in progress at the start of the booking.
    Active runs wait and continue afterwards. Nothing is interrupted. `labos bookings` lists the bookings,
    `labos calendar` shows those of a week.

    \b
    labos book ot2_pcr_alpha --from "tomorrow 09:00" --to 12:00 --for chemistry
    labos book rpl --from "mon 08:00" --to +1h --maintenance --every week
    labos book change B3 --to 13:00
    labos book cancel B3
    """


@command.command("add", short_help="Book a module or a workcell.")
@click.argument("target", shell_complete=make_completer("module"))
@_booking_options
def add(target: str, asker: Asker, **given: Any) -> None:
    """Book TARGET, a module or a workcell. The word `add` may be left out.

    A repeated booking keeps its local time when daylight saving time begins or ends.

    \b
    labos book ot2_pcr_alpha --from "2026-11-26 09:00" --to 17:00 --for chemistry
    labos book hidex --from "tue 14:00" --to +2h --every week --until 2027-03-31
    """
    if given["begins"] is None or given["ends"] is None:
        raise BadInput(
            f"The booking of {target} has no start or no end.",
            remedy=f'labos book {target} --from "tomorrow 09:00" --to 12:00',
        )
    zone = expect_zone(given["zone"])
    terms = {**_read_terms(given, zone), "zone": zone}
    with asker.lab() as client:
        found = client.book(target, terms.pop("begins_at"), terms.pop("ends_at"), asker.user, **terms)
    _report_booking(found)


@command.command("change", short_help="Change the times or the holder of a booking.")
@_booking
@_booking_options
def change(booking: str, asker: Asker, **given: Any) -> None:
    """Change BOOKING. Values without an option stay as they are. With a new start alone, the booking moves
    and keeps its duration.

    \b
    labos book change B3 --from "fri 09:00"
    labos book change B3 --to now
    """
    with asker.lab() as client:
        known = client.booking(booking)
        zone = known["zone"] if given["zone"] is None else expect_zone(given["zone"])
        terms = _read_terms(given, zone, known["begins_at"])
        found = client.change_booking(booking, asker.user, **terms)
    _report_booking(found)


def _read_terms(given: Mapping[str, Any], zone: str, begins_at: int = 0) -> dict[str, Any]:
    """The given options in the form that the client accepts. An end such as ``+2h`` counts from the given
    start, else from ``begins_at``. Raises BadInput."""
    from labos.cli._query import now_ns

    now = now_ns()
    terms = {name: given[name] for name in ("whom", "why", "zone", "force")}
    terms["maintenance"] = given["maintenance"] or None
    if given["begins"] is not None:
        terms["begins_at"] = begins_at = parse_when(given["begins"], now, zone)
    if given["ends"] is not None:
        terms["ends_at"] = parse_when(given["ends"], now, zone, after=begins_at)
    if given["last"] is not None:
        terms["last_at"] = parse_when(given["last"], now, zone)
    if given["every"] is not None or given["rule"] is not None:
        terms["rule"] = rule_of(given["every"], given["rule"])
    return {name: value for name, value in terms.items() if value is not None}


@command.command("cancel", short_help="Cancel a booking, or one time of it.")
@_booking
@click.option("--on", metavar="DAY", help="Cancel only the time that begins on this day.")
@_why
@asker_options
def cancel(booking: str, on: str | None, why: str | None, asker: Asker) -> None:
    """Cancel BOOKING: all users can use the time again. For a repeated booking, this cancels all future
    times, or with --on one time.

    \b
    labos book cancel B3
    labos book cancel B3 --on 2026-12-24 --why holiday
    """
    with asker.lab() as client:
        begins_at = _find_time_on(client, booking, on) if on else 0
        client.cancel_booking(booking, asker.user, begins_at=begins_at, why=why or "")
    message = f"{booking} is cancelled{f' on {on}' if on else ''}."
    report_done(message, {"booking": booking, "begins_at": begins_at, "cancelled": True})


@command.command("show")
@_booking
@lab_and_json
def show(booking: str, asker: Asker) -> None:
    """Show the times of BOOKING and for whom it is.

    \b
    labos book show B3
    """
    with asker.lab() as client:
        found = client.booking(booking)
    end_with_json(found)
    show_bookings([found])


def _find_time_on(client: Any, booking: str, on: str) -> int:
    """When a booking begins on a day (UTC ns). Raises BadInput."""
    from labos.cli._query import now_ns

    known = client.booking(booking)
    day = parse_when(on, now_ns(), known["zone"])
    found = client.calendar(day, day + DAY_NS, known["target"])["times"]
    times = [time["begins_at"] for time in found if time["booking"] == booking and time["begins_at"] >= day]
    if not times:
        raise BadInput(
            f"{booking} has no time that begins on {on}.",
            remedy=f"Its times: labos calendar {known['target']}",
        )
    return int(times[0])


def _report_booking(found: dict[str, Any]) -> None:
    over = f" It overlaps with {', '.join(found['over'])}." if found["over"] else ""
    report_done(f"{found['id']}: {describe_booking(found)}.{over}", found)
