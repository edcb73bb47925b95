"""``labos db``: the database that holds the log."""

from __future__ import annotations

from typing import Any

import click

from labos.cli._group import Suggesting
from labos.cli._out import end_with_json, report_done
from labos.cli._query import Where, folder_and_json, folder_options, now_ns, open_log
from labos.errors import Refused
from labos.services.times import iso_time, show_time
from labos.store import (
    DatabaseStatus,
    find_lease_holder,
    forget_end,
    grant_writer,
    measure_database,
    migrate,
    raise_epoch,
    read_database_status,
    scrub_words,
    show_url,
)


@click.group("db", cls=Suggesting, short_help="Show the state of the database, or migrate it.")
def command() -> None:
    """Manage the database that holds the log.

    \b
    labos db status        show revision, size, end of the log, and the kernel that writes it
    labos db upgrade       upgrade it to this version of LabOS
    labos db restored      record that it was restored from a copy
    labos db writer ROLE   let a PostgreSQL role write the log, and nothing else
    labos db scrub         remove all traces of erased texts from its files
    labos db url           show which database the other commands use
    """


@command.command("status")
@folder_and_json
def status(where: Where) -> None:
    """Show revision, size, end of the log, and whether a kernel runs. Exit code 1 if this version of LabOS
    cannot use the database as it is."""
    found = read_database_status(where.url)
    facts = _list_facts(where, found)
    end_with_json(facts, int(found.state != "current"))
    click.echo(f"{found.name}: {_describe_status(found)}")
    if "bytes" in facts:
        click.echo(f"Size: {facts['bytes'] / 1e6:.1f} MB")
    if "position" in facts:
        last = show_time(facts["recorded_at"]) or "never"
        click.echo(f"Lab: {facts['lab'] or 'none yet'}")
        click.echo(f"Head: position {facts['position']}, epoch {facts['epoch']}, last event {last}")
        click.echo(f"Hash: {facts['hash']}")
    click.echo(f"Kernel: {facts['kernel'] or 'none'}")
    if found.state != "current":
        click.get_current_context().exit(1)


@command.command("upgrade")
@folder_and_json
def upgrade(where: Where) -> None:
    """Upgrade an older or empty database to this version of LabOS. The command is refused while a kernel
    runs. It never changes a database of a newer LabOS."""
    found = read_database_status(where.url)
    if found.state == "current":
        message = f"The {found.name} is already at revision {found.revision}."
        report_done(message, {"before": found.revision, "revision": found.revision})
        return
    owner = find_lease_holder(where.url)
    if owner:
        raise Refused(
            f"A kernel ({owner}) is running on the {found.name}.",
            remedy="Stop it first: Ctrl-C where labos up runs.",
        )
    if found.state == "older":
        advice = f"Make a backup first: labos backup FOLDER --database {show_url(where.url)}"
        click.echo(advice, err=True)
    revision = migrate(where.url)
    before = found.revision or "no revision"
    message = f"The {found.name} was upgraded from {before} to revision {revision}."
    report_done(message, {"before": found.revision, "revision": revision})


@command.command("restored")
@folder_and_json
def record_restored(where: Where) -> None:
    """Record that this database was restored from a copy that another program than labos backup made. The
    next kernel has a higher epoch than the nodes have ever seen. It starts no action until a person has
    checked the bench (labos bench round). The former end of the log no longer counts. The command is
    refused while a kernel runs."""
    found = read_database_status(where.url)
    if found.state != "current":
        raise Refused(f"{found.name}: {_describe_status(found)}.", remedy="No epoch has to be exceeded.")
    before, after = raise_epoch(where.url, now_ns())
    forget_end(where.home)
    message = f"The {found.name} continues with an epoch above {after}; it was {before}."
    report_done(message, {"before": before, "above": after})


@command.command("writer")
@click.argument("role")
@folder_options
def writer(where: Where, role: str) -> None:
    """Grant ROLE the rights that a kernel needs on this PostgreSQL database. The role may append records to
    the log, but not change or delete them. Run this command with the owner's URL (--database). Then let
    the lab connect as this role."""
    grant_writer(where.url, role)
    click.echo(
        f"{role} may write the log in {show_url(where.url)}: add records, move the head, keep snapshots."
    )
    click.echo("It may not change, delete or truncate records, nor upgrade the tables: the owner does that.")


@command.command("scrub")
@folder_and_json
def scrub(where: Where) -> None:
    """Remove all traces of erased texts from the database's files. `labos erase` does this itself. Use this
    command if `labos erase` reports that traces are left. On PostgreSQL it rewrites the table of texts. The
    owner's URL always has the right to do this (--database). The lab may run. Exit code 1 if traces are
    still left.

    The command cannot change PostgreSQL's write-ahead log and its archive. Texts stay in them until you
    delete these files.
    """
    left = scrub_words(where.url)
    message = f"Traces may be left: {left}." if left else "The files contain no traces of erased texts."
    report_done(message, {"left": left})
    if left:
        click.get_current_context().exit(1)


@command.command("url")
@folder_and_json
def url(where: Where) -> None:
    """Show which database is used, with its password hidden. It is the first of these that is set:
    --database, LABOS_DATABASE_URL, the database of the lab's kernel, labos.db in the lab's folder."""
    report_done(show_url(where.url), {"url": show_url(where.url)})


def _list_facts(where: Where, found: DatabaseStatus) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "name": found.name,
        "url": show_url(where.url),
        "state": found.state,
        "revision": found.revision,
        "expected": found.expected,
        "kernel": find_lease_holder(where.url),
    }
    if found.state != "missing":
        facts["bytes"] = measure_database(where.url)
    if found.state == "current":
        with open_log(where) as store:
            head = store.head()
        facts |= {
            "lab": head.lab if head.position else "",
            "position": head.position,
            "epoch": head.epoch,
            "hash": head.hash.hex(),
            "recorded_at": head.recorded_at,
            "time": iso_time(head.recorded_at) if head.recorded_at else "",
        }
    return facts


def _describe_status(found: DatabaseStatus) -> str:
    match found.state:
        case "current":
            return f"revision {found.revision}, the one of this LabOS"
        case "missing":
            return "the file does not exist yet; labos up or labos demo creates it"
        case "empty":
            return "it has no log yet; labos up or labos db upgrade creates one"
        case "older":
            return f"revision {found.revision}, older than {found.expected}: labos db upgrade"
    return f"revision {found.revision}, of a newer LabOS than this one ({found.expected}): upgrade LabOS"
