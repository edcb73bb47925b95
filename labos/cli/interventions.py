"""``labos interventions``: the lab's questions to people, and the answers."""

from __future__ import annotations

import click
from msgspec import to_builtins

from labos.cli._liveness import find_lab_now, open_current_log
from labos.cli._out import end_with_json, show_table
from labos.cli._query import Where, log_and_json
from labos.core.state import LabState
from labos.services.history import fold_state_at
from labos.services.interventions import (
    WITHDRAWN,
    InterventionHistory,
    describe_whereabouts,
    list_intervention_histories,
)
from labos.services.times import show_span, show_time


@click.command("interventions", short_help="List questions of the lab to people, with possible answers.")
@click.option("--all", "everything", is_flag=True, help="Show answered questions too: answer, user and time.")
@log_and_json
def command(where: Where, everything: bool) -> None:
    """List the questions that wait for a person. For each, show its time, its subject, where the labware is
    now as far as the lab knows, and all choices with their consequences and commands. The list includes
    planned work.

    \b
    labos interventions
    labos interventions --all      also answered questions
    labos resolve I2 done          answer one
    """
    with open_current_log(where) as store:
        stories = list(list_intervention_histories(store).values())
        now = find_lab_now(where.url, store.head())
        places = _find_places(fold_state_at(store)) if any(story.open for story in stories) else {}
    shown = [story for story in stories if everything or story.open]
    end_with_json([{**to_builtins(s), "open": s.open, "now": places.get(s.id, "")} for s in shown])
    answered = [story for story in shown if not story.open]
    if answered:
        rows = [_row(story) for story in answered]
        show_table(("id", "asked", "answered", "by", "choice", "about", "question"), rows)
        click.echo()
    waiting = [story for story in shown if story.open]
    for story in waiting:
        _show_question(story, now, places.get(story.id, ""))
    if not waiting:
        click.echo("No question is open.")
    if not everything and len(stories) > len(shown):
        more = len(stories) - len(shown)
        click.echo(f"{more} more {'is' if more == 1 else 'are'} answered: labos interventions --all")


def _find_places(state: LabState) -> dict[str, str]:
    """The present place of the labware of each question, as far as the lab knows."""
    return {
        name: describe_whereabouts(state, question) for name, question in state.interventions.open.items()
    }


def _show_question(story: InterventionHistory, now: int, place: str) -> None:
    waited = show_span(max(now - story.requested_at, 0) / 1e9)
    due = f", due {show_time(story.due_at)}{' (late)' if story.overdue else ''}" if story.due_at else ""
    click.echo(f"{story.id}  {story.text}")
    click.echo(f"      since {show_time(story.requested_at)} ({waited}){due}; about {', '.join(story.about)}")
    if place and place not in story.text:
        click.echo(f"      now {place}")
    for answer in story.answers:
        click.echo(f"      {answer.command}   {answer.consequence}")


def _row(story: InterventionHistory) -> tuple[str, ...]:
    choice = "auto-resolved" if story.choice == WITHDRAWN else story.choice
    return (
        story.id,
        show_time(story.requested_at),
        show_time(story.resolved_at),
        story.by,
        f"{choice} ({story.note})" if story.note else choice,
        ", ".join(story.about),
        story.text,
    )
