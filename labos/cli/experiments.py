"""``labos experiments``: applications and their runs."""

from __future__ import annotations

import click

from labos.cli._liveness import open_current_log
from labos.cli._options import ENDED_SHOWN, all_option
from labos.cli._out import end_with_json, show_table
from labos.cli._query import Where, log_and_json
from labos.services.experiments import ExperimentHistory, list_experiment_histories
from labos.services.times import show_span, show_time


@click.command("experiments", short_help="List experiments.")
@all_option
@log_and_json
def command(where: Where, everything: bool) -> None:
    """List open experiments and the last ones that ended.

    \b
    labos experiments
    labos runs E1                  its runs
    labos explain E1               why its runs wait
    labos log --experiment E1      what happened in one
    """
    with open_current_log(where) as store:
        stories = list(list_experiment_histories(store).values())
    ended = [story.id for story in stories if story.ended_at]
    hidden = set() if everything else set(ended[:-ENDED_SHOWN])
    shown = [story for story in stories if story.id not in hidden]
    end_with_json(shown)
    show_table(("id", "name", "user", "status", "runs", "started", "took"), [_row(story) for story in shown])
    if hidden:
        click.echo(f"{len(hidden)} more experiments have ended: labos experiments --all")


def _row(story: ExperimentHistory) -> tuple[str, ...]:
    kinds = ("alive", "completed", "failed", "cancelled")
    runs = ", ".join(f"{story.count(kind)} {kind}" for kind in kinds if story.count(kind)) or "none"
    status = story.status if story.why in ("", "ended") else f"{story.status} ({story.why})"
    span = show_span((story.ended_at - story.started_at) / 1e9) if story.ended_at else ""
    return story.id, story.name, story.user, status, runs, show_time(story.started_at), span
