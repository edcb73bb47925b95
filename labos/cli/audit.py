"""``labos audit``: the audit tables for queries in SQL."""

from __future__ import annotations

import os
import threading

import click

from labos.cli._audit import open_projector, show_progress
from labos.cli._group import Suggesting
from labos.cli._out import report_done
from labos.cli._query import Where, folder_and_json, folder_options
from labos.errors import BadInput
from labos.services.times import iso_time, show_time

CALM = 10
"""The priority of the follower below other processes (``nice``)."""


@click.group("audit", cls=Suggesting, short_help="Manage the tables that SQL queries read.")
def command() -> None:
    """Manage the tables for SQL queries (`labos sql`) and dashboards.

    For a log in SQLite, the tables are in a separate file beside it (labos-audit.db beside labos.db). On
    PostgreSQL they are in separate schemas. They contain only data from the log. LabOS builds them again if
    they are missing, older than this LabOS, or from another log.
    """


@command.command("project")
@click.option("-f", "--follow", is_flag=True, help="Continue with new events, until Ctrl-C.")
@click.option(
    "--every",
    type=click.FloatRange(min=0.1),
    default=1.0,
    show_default=True,
    metavar="SECONDS",
    help="How often to check for new events.",
)
@folder_and_json
def project(where: Where, follow: bool, every: float) -> None:
    """Update the tables from the log. `labos sql` and `labos provenance` do this themselves. For dashboards,
    run this command with --follow.

    You can kill this command at any moment, and run several at once: no event is left out or entered twice.
    It never writes to the log, and the kernel does not wait for it.

    \b
    labos audit project              once
    labos audit project --follow     for a dashboard
    """
    if follow and hasattr(os, "nice"):
        os.nice(CALM)
    with open_projector(where) as (_, database, projector):
        position = projector.catch_up(show_progress)
        _report_position(position, database.name)
        ended = threading.Event()
        while follow:
            try:
                ended.wait(every)
                projector.catch_up()
            except KeyboardInterrupt:
                return


@command.command("rebuild")
@folder_and_json
def rebuild(where: Where) -> None:
    """Delete the tables and build them again from the log."""
    with open_projector(where) as (_, database, projector):
        database.reset()
        _report_position(projector.catch_up(show_progress), database.name)


@command.command("status")
@folder_and_json
def status(where: Where) -> None:
    """Show how far the tables are behind the log."""
    with open_projector(where) as (store, database, _):
        mark, head = database.prepare(), store.head()
    behind = head.position - mark.position
    at = round((mark.at_s or 0) * 1e9)
    facts = {"database": database.name, "position": mark.position, "behind": behind}
    until = f", which was recorded at {show_time(at)}" if at else ""
    report_done(
        f"The {database.name} is at event {mark.position}{until}: {behind} behind the log.",
        {**facts, "log": head.position, "recorded": iso_time(at) if at else ""},
    )


@command.command("reader")
@click.argument("role")
@folder_options
def reader(where: Where, role: str) -> None:
    """Let ROLE of a PostgreSQL database read the views, and nothing else. Use such a role for a dashboard.

    \b
    CREATE ROLE grafana LOGIN PASSWORD '…';
    labos audit reader grafana
    """
    with open_projector(where) as (_, database, projector):
        if database.dialect != "postgresql":
            raise BadInput(
                "SQLite has no roles: a user who may read the file may read all of it.",
                remedy="Give the dashboard's user read permission for the file.",
            )
        projector.catch_up(show_progress)
        from labos.audit._postgres import PostgresAudit

        assert isinstance(database, PostgresAudit)
        database.allow_reading(role)
    click.echo(f"{role} may read the views (schema labos) and nothing else of LabOS.")


def _report_position(position: int, name: str) -> None:
    report_done(f"The {name} is at event {position}.", {"database": name, "position": position})
