"""The statistics of a lab, for people."""

from __future__ import annotations

import click

from labos.cli._out import show_table
from labos.core.ids import local
from labos.services.summary import RunSummary, Summary
from labos.services.times import show_span

WAITS_SHOWN = 2


def show_summary(summary: Summary) -> None:
    """Print runs, modules, users and the time without human intervention."""
    fast = summary.pace != 1
    columns = [
        "run",
        "workflow",
        "user",
        "status",
        "steps",
        "wall",
        "working",
        "waiting",
        "queued",
        "waited for",
    ]
    if fast:
        columns.insert(6, "lab time")
    show_table(columns, [_run(run, fast) for run in summary.runs], title="Runs")
    rows = [
        (
            local(m.name),
            f"{m.utilisation:.0%}",
            str(m.actions),
            str(m.failed),
            str(m.unknown),
            show_span(m.busy_s),
        )
        for m in summary.modules
    ]
    show_table(("module", "in use", "actions", "failed", "unknown", "busy"), rows, title="Modules", gap=True)
    users = [
        (u.name, f"{u.completed} of {u.runs}", str(u.actions), show_span(u.lab_s if fast else u.module_s))
        for u in summary.users
    ]
    show_table(("user", "runs completed", "actions", "module time"), users, title="Users", gap=True)
    click.echo(f"\n{describe_summary(summary)}")


def describe_summary(summary: Summary) -> str:
    """Time without human intervention in one sentence."""
    twh = summary.twh.lab
    longest = twh.longest.worked_ns / 1e9
    lab_time = f" ({show_span(longest * summary.pace)} of lab time)" if summary.pace != 1 else ""
    times = "no intervention" if not twh.interventions else f"{twh.interventions} interventions"
    if twh.interventions == 1:
        times = "one intervention"
    return (
        f"Longest time without human intervention: {show_span(longest)}{lab_time}, "
        f"{twh.longest.commands} actions completed in it; {times} in all."
    )


def _run(run: RunSummary, fast: bool) -> list[str]:
    waited = "; ".join(f"{wait.why} ({show_span(wait.seconds)})" for wait in run.waits[:WAITS_SHOWN])
    row = [run.id, run.workflow, run.user, run.status, f"{run.done}/{run.steps}", show_span(run.wall_s)]
    if fast:
        row.append(show_span(run.lab_s))
    spans = [show_span(seconds) for seconds in (run.working_s, run.waiting_s, run.queued_s)]
    return [*row, *spans, run.why or waited]
