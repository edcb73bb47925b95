"""The audit tables for commands: they are brought up to date before a query."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager

import click

from labos.audit.database import AuditDatabase, make_audit_url, open_audit
from labos.audit.projector import Projector
from labos.audit.query import TIME_LIMIT_S, ReadConnection, open_asker
from labos.cli._query import Where, open_database
from labos.services.shown import ShownLog
from labos.store import SqlEventStore, find_sqlite_path, open_blobs

SHOWN_FROM = 20_000
"""With at least so many new events, the progress is shown."""


@contextmanager
def open_projector(where: Where) -> Iterator[tuple[SqlEventStore, AuditDatabase, Projector]]:
    """The log, its audit tables, and the projector that updates them."""
    with open_database(where) as store, closing(open_audit(where.url)) as database:
        blobs = open_blobs(where.settings.blobs)
        yield store, database, Projector(ShownLog(store), database, blobs)


@contextmanager
def open_log_and_views(
    where: Where, limit_s: float = TIME_LIMIT_S
) -> Iterator[tuple[SqlEventStore, ReadConnection]]:
    """The log and the views, which include all events of the log up to now. Raises BadInput,
    StoreUnavailable."""
    with open_projector(where) as (store, _, projector):
        projector.catch_up(show_progress)
        with open_asker(where.url, limit_s) as asker:
            yield store, asker


@contextmanager
def open_views(where: Where, limit_s: float = TIME_LIMIT_S) -> Iterator[ReadConnection]:
    """The same, for commands that need only the views."""
    with open_log_and_views(where, limit_s) as (_, asker):
        yield asker


def forget_erased(where: Where) -> bool:
    """Delete erased words from the audit tables too; False if there are no tables. Raises
    StoreUnavailable."""
    url = make_audit_url(where.url)
    if url.get_backend_name() == "sqlite" and not find_sqlite_path(url).exists():
        return False
    with open_projector(where) as (_, database, projector):
        if database.is_made:
            projector.catch_up(show_progress)
            return True
    return False


def show_progress(position: int, head: int) -> None:
    """Show the progress on one line that changes, on a terminal."""
    if head < SHOWN_FROM or not sys.stderr.isatty():
        return
    end = "\n" if position >= head else ""
    click.echo(f"\rReading the log: {position:,} of {head:,} events{end}", nl=False, err=True)
