"""``labos results``: the values that a run measured, well by well."""

from __future__ import annotations

import sys
from typing import TextIO

import click

from labos.cli._complete import make_completer
from labos.cli._liveness import open_current_log
from labos.cli._out import end_with_json, show_table
from labos.cli._query import Where, log_at_and_json, open_contents
from labos.services.history import find_position_at
from labos.services.results import COLUMNS, read_readings
from labos.services.times import Moment, show_time


@click.command("results", short_help="Show what a run measured, well by well.")
@click.argument("run", shell_complete=make_completer("run"))
@click.option("--csv", "as_csv", is_flag=True, help="CSV, for spreadsheets; times in UTC.")
@click.option(
    "-o",
    "--output",
    "file",
    type=click.File("w", encoding="utf-8", lazy=True),
    metavar="FILE",
    help="Write the CSV to this file.",
)
@log_at_and_json
def command(where: Where, run: str, as_csv: bool, file: TextIO | None, moment: Moment) -> None:
    """Show the results of RUN that have a value for each well, with the sample in the well.

    \b
    labos results R3
    labos results R3 --csv
    labos results R3 -o r3.csv
    """
    with open_current_log(where, moment, last_known=False) as store, open_contents(where) as blobs:
        found = read_readings(store, blobs, run, find_position_at(store, moment))
    end_with_json([dict(zip(COLUMNS, row, strict=True)) for row in found.rows()])
    if as_csv or file is not None:
        found.to_csv(file or sys.stdout)
    elif found:
        show_table(COLUMNS, [tuple(map(str, row)) for row in found.rows(show_time)])
    else:
        click.echo(f"{run} has no results by well.")
