"""``labos twh``: time without human intervention, and the causes of the other time."""

from __future__ import annotations

import click

from labos.cli._complete import name_option
from labos.cli._liveness import find_lab_now, open_current_log
from labos.cli._out import show_json, show_table, wants_json
from labos.cli._query import Where, log_and_json
from labos.cli._why import make_plain_twh, show_why, why_as_json
from labos.errors import NotFound
from labos.services.losses import sum_losses
from labos.services.times import show_span, show_time
from labos.services.twh import Stretch, Twh, TwhReport, measure

RUNS_SHOWN = 20


@click.command("twh", short_help="Show the time without human intervention.")
@name_option("run", "R", "Show only this run.")
@name_option("experiment", "E", "Show only this experiment.")
@name_option("workcell", "W", "Show only this workcell.")
@click.option(
    "--losses", is_flag=True, help="Show the causes of lost time, and when a person is needed next."
)
@log_and_json
def command(where: Where, run: str, experiment: str, workcell: str, losses: bool) -> None:
    """Show the time without human intervention (TWH) of the lab, its workcells, experiments and runs.

    \b
    labos twh                     the lab and everything in it
    labos twh --experiment E1     one experiment
    labos twh --losses            every lost minute with its cause

    The time of a run counts from its first step to its end, except while it is paused or waits for a person.
    A person's answer, or access to the workcell, ends the current interval.
    docs/time-without-human-intervention.md has the exact definition.
    """
    with open_current_log(where, last_known=False) as store:
        now = find_lab_now(where.url, store.head())
        found = sum_losses(store.read(), now) if losses else None
        report = found.twh if found is not None else measure(store.read(), now)
    shown = choose_scopes(report, run, experiment, workcell)
    if found is not None:
        (why_as_json if wants_json() else show_why)(found, shown)
    elif wants_json():
        show_json({"pace": report.pace, "scopes": [make_plain_twh(twh) for twh in shown]})
    else:
        _show(report, shown)


def _show(report: TwhReport, shown: list[Twh]) -> None:
    columns = ["scope", "current", "commands", "longest", "commands", "from", "to"]
    columns += ["interventions", "planned"]
    if report.pace != 1:
        columns.insert(5, "longest in lab time")
    show_table(columns, [_row(twh, report.pace) for twh in shown])


def choose_scopes(report: TwhReport, run: str, experiment: str, workcell: str) -> list[Twh]:
    """The requested scopes; by default the lab, all workcells and experiments, and the last runs. Raises
    NotFound."""
    found: list[Twh] = []
    wanted = (("run", run, report.runs), ("experiment", experiment, report.experiments))
    for kind, name, known in (*wanted, ("workcell", workcell, report.workcells)):
        if name:
            if name not in known:
                raise NotFound(f"No {kind} {name!r} has started a step.", remedy="List all: labos twh")
            found.append(known[name])
    runs = list(report.runs.values())[-RUNS_SHOWN:]
    return found or [report.lab, *report.workcells.values(), *report.experiments.values(), *runs]


def _row(twh: Twh, pace: float) -> list[str]:
    name = f"{twh.kind} {twh.name}".strip()
    current = _show_worked(twh.current) + (" and counting" if twh.working else "")
    row = [name, current, str(twh.current.commands), _show_worked(twh.longest), str(twh.longest.commands)]
    if pace != 1:
        row.append(show_span(twh.longest.worked_ns / 1e9 * pace))
    row += [show_time(twh.longest.since), show_time(twh.longest.until)]
    return [*row, str(twh.interventions), str(twh.planned)]


def _show_worked(stretch: Stretch) -> str:
    return show_span(stretch.worked_ns / 1e9)
