"""``labos log``: shows the events."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import Any

import click

from labos.cli._complete import name_option
from labos.cli._liveness import open_current_log
from labos.cli._options import json_option_saying
from labos.cli._out import wants_json
from labos.cli._query import Where, as_time, log_options
from labos.core.envelope import Record
from labos.core.registry import Event
from labos.services.describe import describe
from labos.services.filters import FilteredLog, LogFilter
from labos.services.times import show_time
from labos.store import encode_record

POLL_S = 0.25


@click.command("log", short_help="Show what happened, event by event.")
@click.option("--type", "types", multiple=True, metavar="T", help="A type or family: action, run.failed …")
@name_option("run", "R", "Events of this run.")
@name_option("module", "M", "Events of this module and its stations.")
@name_option("labware", "P", "Events of this labware.")
@click.option("--user", default="", metavar="U", help="Events by this user and for this user.")
@name_option("experiment", "E", "Events of this experiment and its runs.")
@click.option(
    "--since",
    "since_ns",
    metavar="T",
    callback=as_time,
    help="From this time on: ISO 8601 (local zone if none), or -2h.",
)
@click.option("--until", "until_ns", metavar="T", callback=as_time, help="Before this time.")
@click.option("--last", type=click.IntRange(min=0), metavar="N", help="Only the last N events.")
@click.option("-f", "--follow", is_flag=True, help="Show new events as they are added, until Ctrl-C.")
@json_option_saying("One line for each event: envelope, hash and payload, as stored.")
@log_options
def command(where: Where, follow: bool, **wanted: Any) -> None:
    """Show the log, one sentence for each event.

    \b
    labos log --last 20                    the newest events
    labos log -f --type run --type action  follow runs and their actions
    labos log --run R3 --since -2h         one run's last two hours
    labos log --labware P7                 all events of a plate
    labos log --module sealer --json       for programs, one event a line

    An event is shown if it matches all filters. The first column is the position in the log. `labos
    stations --at POSITION` shows the lab at that moment.
    """
    stored = wants_json()
    with open_current_log(where, stored=stored, last_known=False) as store, suppress(KeyboardInterrupt):
        seen = store.head().position
        sieve = FilteredLog(store, LogFilter(**wanted))
        shown = 0
        for event, record in sieve.read_matching(seen):
            _show(sieve, event, record)
            shown += 1
        if (user := sieve.wanted.user) and not shown and not sieve.knows_user():
            click.echo(f"labos: This log has no events by {user!r} or for {user!r}.", err=True)
        while follow:
            end = store.head().position
            if end > seen:
                for event, record in sieve.read_later(seen, end):
                    _show(sieve, event, record)
                seen = end
            time.sleep(POLL_S)


def _show(sieve: FilteredLog, event: Event, record: Record) -> None:
    if wants_json():
        click.echo(encode_record(record))
        return
    head = record.head
    kind = click.style(f"{head.type:<22}", fg="cyan")
    when = show_time(head.recorded_at)
    click.echo(f"{head.position:>6}  {when}  {kind} {describe(event, head, sieve.names)}")
