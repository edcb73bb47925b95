"""``labos handover-report``: a report for the next shift."""

from __future__ import annotations

import click

from labos.cli._liveness import find_lab_now, has_kernel, open_current_log
from labos.cli._out import end_with_json, show_table
from labos.cli._query import Where, log_and_json, now_ns
from labos.services.describe import owner_name
from labos.services.handover import Handover, OpenRun, read_handover
from labos.services.times import parse_time, show_span, show_time

SHIFT = "-8h"


@click.command("handover-report", short_help="Write a report for the next shift.")
@click.option(
    "--since",
    metavar="TIME",
    default=SHIFT,
    show_default=True,
    help="The start of the shift: 2026-05-04T06:00, -8h.",
)
@log_and_json
def command(where: Where, since: str) -> None:
    """Write a summary of a shift: open and ended runs, open questions, labware that no run uses, resources
    that run out next, and how long the lab worked without intervention.

    \b
    labos handover-report
    labos handover-report --since 2026-05-04T06:00 --json
    """
    began = parse_time(since, now_ns())
    with open_current_log(where) as store:
        until = max(find_lab_now(where.url, store.head()), began)
        found = read_handover(store, began, until, kernel_runs=has_kernel(where.url))
    end_with_json(found)
    click.echo(f"{found.lab}: from {show_time(found.since)} to {show_time(found.until)}")
    _show_runs(found)
    _show_people(found)
    _show_bench(found)
    click.echo(f"\n{_describe_unattended(found)}")


def _show_runs(found: Handover) -> None:
    rows = [_run(run) for run in (*found.running, *found.queued)]
    more = found.queued_in_all - len(found.queued)
    show_table(
        ("run", "workflow", "user", "status", "steps", "does, or waits for"), rows, title="Runs", gap=True
    )
    if more:
        click.echo(f"{more} more are queued behind them: labos runs")
    if found.ended:
        ended = [(run.run, run.workflow, run.user, run.status, run.why) for run in found.ended]
        show_table(
            ("run", "workflow", "user", "came out", "why"), ended, title="Ended in this shift", gap=True
        )


def _run(run: OpenRun) -> tuple[str, ...]:
    what = "; ".join(run.doing or run.waits)
    stuck = " (a person or a device has to act first)" if run.stuck else ""
    steps = f"{run.done}/{run.steps}"
    return run.run, run.workflow, run.user, run.status, steps, what + stuck


def _show_people(found: Handover) -> None:
    click.echo("\nWaits for a person")
    for asked in found.questions:
        due = f" (due {show_time(asked.due_at)}{', LATE' if asked.overdue else ''})" if asked.due_at else ""
        click.echo(f"  {asked.id}{due}: {asked.text}")
        click.echo(f"      {asked.answer}")
    for away in found.away:
        until = f" until {show_time(away.until)}" if away.until else ""
        click.echo(f"  {away.module} is {away.status}{until}{f': {away.why}' if away.why else ''}")
    for held in found.held:
        click.echo(f"  {held.by} reaches into {held.workcell} since {show_time(held.since)}")
    if not (found.questions or found.away or found.held):
        click.echo("  nothing")


def _show_bench(found: Handover) -> None:
    if found.labware:
        rows = [
            (
                piece.labware,
                piece.type,
                f"perhaps {', '.join(piece.maybe)}" if piece.maybe else piece.station,
                owner_name(piece.owner) + (f" (given by {piece.given_by})" if piece.given_by else ""),
            )
            for piece in found.labware
        ]
        show_table(
            ("labware", "type", "stands at", "belongs to"), rows, title="Labware that no run uses", gap=True
        )
    click.echo("\nRuns out next")
    for short in found.runs_out:
        click.echo(
            f"  {short.what} at {show_time(short.at)}, in {short.run} ({short.workflow}: {short.step!r})"
        )
    for pack in found.expired:
        click.echo(
            f"  {pack.module} {pack.resource}: lot {pack.lot} expired on {pack.expires} ({pack.left:g} left)"
        )
    if not (found.runs_out or found.expired):
        click.echo("  no resource that the present runs need")


def _describe_unattended(found: Handover) -> str:
    twh = found.twh
    lab_time = ""
    if found.pace != 1:
        lab_time = f" ({show_span(twh.longest.worked_ns / 1e9 * found.pace)} of lab time)"
    return (
        f"Time without human intervention in this shift: {show_span(twh.longest.worked_ns / 1e9)}{lab_time} "
        f"at the longest, {twh.longest.commands} actions completed in it; "
        f"interventions: {twh.interventions}, planned touches: {twh.planned}."
    )
