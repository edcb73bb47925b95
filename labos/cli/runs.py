"""``labos runs``: the runs and their progress."""

from __future__ import annotations

from typing import Any

import click
import msgspec

from labos.cli._complete import make_completer
from labos.cli._liveness import find_lab_now, has_kernel, open_current_log
from labos.cli._options import ENDED_SHOWN, all_option
from labos.cli._orders import KernelWaits, ask_order_setting
from labos.cli._out import end_with_json, show_parts, show_table
from labos.cli._query import Where, log_and_json
from labos.core.ids import local
from labos.core.model import find_served_step
from labos.planning.scheduler import Scheduler
from labos.services.describe import shorten_value
from labos.services.due import describe_due
from labos.services.experiments import list_experiment_histories
from labos.services.history import fold_state_at
from labos.services.log import Log
from labos.services.runs import RunHistory, StepHistory, run_histories, run_history
from labos.services.times import show_span, show_time
from labos.services.waits import list_reasons

WAITS_TOLD = 50
"""For at most so many runs, the reason for waiting is computed; for all of them it would take too long."""


@click.command("runs", short_help="List runs and their progress, or the steps of one run.")
@click.argument(
    "run", shell_complete=make_completer("run", "experiment"), metavar="[RUN|EXPERIMENT]", required=False
)
@all_option
@log_and_json
def command(where: Where, run: str | None, everything: bool) -> None:
    """List open runs and the last ones that ended. With RUN, list its steps. With EXPERIMENT, list all its
    runs.

    \b
    labos runs            open runs, and the last ones that ended
    labos runs --all      all runs ever
    labos runs R3         each step: when, how long, result or error
    labos runs E1         the runs of an experiment
    labos explain R3      why the run waits
    """
    with open_current_log(where) as store:
        inside = list_experiment_histories(store).get(run) if run and run.startswith("E") else None
        if inside is not None:
            stories = {name: run_history(store, name) for name in inside.runs}
        else:
            stories = {run: run_history(store, run)} if run else run_histories(store)
        now = find_lab_now(where.url, store.head())
        lives = has_kernel(where.url)
        waits = _find_waits(store, stories, now, KernelWaits(where) if lives else None)
        due = _find_due(store, stories, now, where)
    if run and inside is None:
        end_with_json(_make_plain(stories[run], waits, due))
        _show_one(stories[run], waits, due)
        return
    ended = [story for story in stories.values() if story.over]
    hidden = {story.id for story in ended[:-ENDED_SHOWN]} if not everything and inside is None else set()
    shown = [story for story in stories.values() if story.id not in hidden]
    end_with_json([_make_plain(story, waits, due) for story in shown])
    columns = ("run", "workflow", "user", "experiment", "status", "steps", "submitted", "took", "due", "why")
    show_table(columns, [_row(story, now, waits, due) for story in shown], optional="due")
    if hidden:
        click.echo(f"{len(hidden)} more runs have ended: labos runs --all")


def _find_waits(
    store: Log, stories: dict[str, RunHistory], now: int, kernel: KernelWaits | None
) -> dict[str, list[str]]:
    """Why runs wait, in sentences."""
    if all(story.over for story in stories.values()):
        return {}
    state = fold_state_at(store)
    scheduler = Scheduler()
    alive = [state.runs.get(name) for name, story in stories.items() if not story.over]
    found: dict[str, list[str]] = {run.id: [] for run in alive[:WAITS_TOLD] if run is not None}
    for question in state.interventions.open.values():
        if question.run in found:
            found[question.run].append(f"a person has to answer {question.id} (labos resolve)")
    for run in alive[:WAITS_TOLD]:
        if run is not None:
            reasons = list_reasons(state, run, now, scheduler)
            if kernel is not None:
                reasons = kernel.correct_reasons(state, run, now, reasons)
            found[run.id] += [reason.why for reason in reasons]
    return {run: reasons for run, reasons in found.items() if reasons}


def _find_due(store: Log, stories: dict[str, RunHistory], now: int, where: Where) -> dict[str, str]:
    """The due dates of runs, and whether the runs will keep them."""
    if not any(story.due_at for story in stories.values()):
        return {}
    searches = ask_order_setting(where)
    return describe_due(fold_state_at(store), stories.values(), now, searches=searches)


def _make_plain(run: RunHistory, waits: dict[str, list[str]], due: dict[str, str]) -> dict[str, Any]:
    return {**msgspec.to_builtins(run), "waits": waits.get(run.id, []), "due": due.get(run.id, "")}


def _row(run: RunHistory, now: int, waits: dict[str, list[str]], due: dict[str, str]) -> tuple[str, ...]:
    steps = f"{run.done}/{run.in_play}"
    name = f"{run.workflow} (closing)" if run.closing else run.workflow
    submitted = show_time(run.submitted_at)
    why = run.why or "; ".join(f"waits: {reason}" for reason in waits.get(run.id, []))
    span = show_duration(run, now)
    known = run.id, name, run.user, run.experiment, run.status, steps, submitted, span
    return *known, due.get(run.id, ""), why


def show_duration(run: RunHistory, now: int) -> str:
    """The duration up to the end, or up to now with a mark that the run continues."""
    if not run.started_at:
        return ""
    if run.ended_at:
        return show_span((run.ended_at - run.started_at) / 1e9)
    return f"{show_span(max(now - run.started_at, 0) / 1e9)} so far"


def _show_one(run: RunHistory, waits: dict[str, list[str]], due: dict[str, str]) -> None:
    experiment = f" in experiment {run.experiment}" if run.experiment else ""
    click.echo(f"{run.id}: {run.workflow} on {run.workcell} for {run.user}{experiment}: {run.status}")
    if run.why:
        click.echo(f"Why: {run.why}")
    for reason in waits.get(run.id, []):
        click.echo(f"Waits: {reason} (labos explain {run.id})")
    if run.due_at:
        click.echo(f"Due: {due[run.id]}")
    times = (("submitted", run.submitted_at), ("started", run.started_at), ("ended", run.ended_at))
    show_parts([f"{what} {show_time(at)}" for what, at in times if at])
    columns = ("#", "step", "action", "state", "requested", "took", "tries", "result or error")
    show_table(
        columns,
        [
            _list_step_cells(step)
            for step in run.steps
            if step.state != "asleep" or find_served_step(step.part) is not None
        ],
        gap=True,
    )


def _list_step_cells(step: StepHistory) -> tuple[str, ...]:
    span = show_span((step.ended_at - step.requested_at) / 1e9) if step.ended_at else ""
    outcome = step.error or (shorten_value(step.result) if step.result is not None else "")
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
