"""``labos runs``: what was asked for and how far it has come."""

from __future__ import annotations

import click

from labos.cli._living import lab_now
from labos.cli._out import show_json, show_table
from labos.cli._query import Where, json_option, log_options, reading
from labos.core.ids import local
from labos.services.describe import short
from labos.services.runs import RunStory, StepStory, run_stories, run_story
from labos.services.times import show_span, show_time

ENDED_SHOWN = 20


@click.command("runs", short_help="Runs, or one run's steps, times, results and errors.")
@click.argument("run", required=False)
@click.option(
    "--all", "everything", is_flag=True, help=f"Also those before the last {ENDED_SHOWN} that ended."
)
@json_option
@log_options
def command(where: Where, run: str | None, everything: bool, as_json: bool) -> None:
    """Runs that have not ended and the last ones that have; with RUN, its steps.

    \b
    labos runs            what is under way, and what ended last
    labos runs --all      all runs ever
    labos runs R3         each step: when, how long, result or error
    labos explain R3      why it does not go on
    """
    with reading(where) as store:
        stories = {run: run_story(store, run)} if run else run_stories(store)
        now = lab_now(where.url, store.head())
    if run:
        show_json(stories[run]) if as_json else _one(stories[run])
        return
    ended = [story for story in stories.values() if story.over]
    hidden = {story.id for story in ended[:-ENDED_SHOWN]} if not everything else set()
    shown = [story for story in stories.values() if story.id not in hidden]
    if as_json:
        show_json(shown)
        return
    columns = ("run", "workflow", "user", "experiment", "status", "steps", "submitted", "took", "why")
    show_table(columns, [_row(story, now) for story in shown])
    if hidden:
        click.echo(f"{len(hidden)} more runs have ended: labos runs --all")


def _row(run: RunStory, now: int) -> tuple[str, ...]:
    steps = f"{run.done}/{len(run.steps)}"
    name = f"{run.workflow} (closing)" if run.closing else run.workflow
    submitted = show_time(run.submitted_at)
    return run.id, name, run.user, run.experiment, run.status, steps, submitted, took(run, now), run.why


def took(run: RunStory, now: int) -> str:
    """From start to end, or to now with a mark that it goes on."""
    if not run.started_at:
        return ""
    if run.ended_at:
        return show_span((run.ended_at - run.started_at) / 1e9)
    return f"{show_span(max(now - run.started_at, 0) / 1e9)} so far"


def _one(run: RunStory) -> None:
    experiment = f" in experiment {run.experiment}" if run.experiment else ""
    click.echo(f"{run.id}: {run.workflow} on {run.workcell} for {run.user}{experiment}: {run.status}")
    if run.why:
        click.echo(f"Why: {run.why}")
    times = (("submitted", run.submitted_at), ("started", run.started_at), ("ended", run.ended_at))
    click.echo("; ".join(f"{what} {show_time(at)}" for what, at in times if at))
    click.echo()
    columns = ("#", "step", "action", "state", "requested", "took", "tries", "result or error")
    show_table(columns, [_step(step) for step in run.steps])


def _step(step: StepStory) -> tuple[str, ...]:
    span = show_span((step.ended_at - step.requested_at) / 1e9) if step.ended_at else ""
    outcome = step.error or (short(step.result) if step.result is not None else "")
    late = "; started too late" if step.breached else ""
    return (
        str(step.index),
        step.key,
        f"{local(step.module)}.{step.action}",
        step.state,
        show_time(step.requested_at),
        span,
        str(step.attempts or ""),
        f"{outcome}{late}",
    )
