"""``labos bookings``: which bookings there are."""

from __future__ import annotations

import click

from labos.cli._bookings import show_bookings
from labos.cli._complete import completes
from labos.cli._options import home_option, json_option
from labos.cli._out import show_json


@click.command("bookings", short_help="List bookings.")
@click.argument("target", required=False, default="", shell_complete=completes("module"))
@home_option
@json_option
def command(target: str, home: str | None, as_json: bool) -> None:
    """List current and future bookings, each with its next time: all, or those of TARGET, a module or a
    workcell.

    \b
    labos bookings
    labos bookings ot2_pcr_alpha
    """
    from labos.cli._lab import need_lab

    with need_lab(home) as client:
        found = client.bookings(target)
    if as_json:
        show_json(found)
    else:
        show_bookings(found)
