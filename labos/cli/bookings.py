"""``labos bookings``: lists the bookings."""

from __future__ import annotations

import click

from labos.cli._bookings import show_bookings
from labos.cli._complete import make_completer
from labos.cli._options import Asker, lab_and_json
from labos.cli._out import end_with_json


@click.command("bookings", short_help="List bookings.")
@click.argument("target", required=False, default="", shell_complete=make_completer("module"))
@lab_and_json
def command(target: str, asker: Asker) -> None:
    """List current and future bookings, each with its next time: all, or those of TARGET, a module or a
    workcell.

    \b
    labos bookings
    labos bookings ot2_pcr_alpha
    """
    with asker.lab() as client:
        found = client.bookings(target)
    end_with_json(found)
    show_bookings(found)
