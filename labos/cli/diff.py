"""``labos diff``: the differences between two moments."""

from __future__ import annotations

import click

from labos.audit.difference import list_differences
from labos.cli._audit import open_log_and_views
from labos.cli._out import end_with_json, show_table
from labos.cli._query import AT_HELP, Where, as_moment, folder_and_json
from labos.errors import BadInput
from labos.services.history import find_position_at
from labos.services.times import Moment


@click.command("diff")
@click.option("--since", "first", metavar="TIME|POSITION", callback=as_moment, required=True, help=AT_HELP)
@click.option(
    "--until", "last", metavar="TIME|POSITION", callback=as_moment, help="A later moment; now if not given."
)
@folder_and_json
def command(where: Where, first: Moment, last: Moment) -> None:
    """Show the differences of the lab between two moments: places of labware, runs, levels of resources,
    questions to people, and versions of drivers.

    \b
    labos diff --since -2h
    labos diff --since 2026-05-04T10:30 --until 2026-05-04T18:00
    """
    with open_log_and_views(where) as (store, asker):
        begin, end = find_position_at(store, first), find_position_at(store, last)
        if begin > end:
            raise BadInput("--since is later than --until.", remedy="Exchange the two times.")
        changes = list_differences(asker, begin, end)
    end_with_json({"since": begin, "until": end, "changes": changes})
    click.echo(f"From event {begin} to event {end}:")
    show_table(("about", "what", "before", "after"), [(c.about, c.what, c.before, c.after) for c in changes])
