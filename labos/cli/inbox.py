"""``labos inbox`` and ``labos confirm``: the work that workflows plan for people."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import click

from labos.cli._complete import offering
from labos.cli._options import home_option, json_option, user_option, who, why_option
from labos.cli._query import Where, log_options, reading
from labos.core.interventions import PLANNED_WORK

if TYPE_CHECKING:
    from labos.services.interventions import InterventionStory


@click.command("inbox")
@click.option("--module", shell_complete=offering("module"), metavar="NAME", help="Of this operator only.")
@json_option
@log_options
def inbox(where: Where, module: str | None, as_json: bool) -> None:
    """The planned work that waits for a person, the most urgent first.

    Each entry is a step of a run on an operator module: the run goes on when somebody confirms it.
    What is late stays in the inbox; nothing fails by that.

    \b
    labos inbox
    labos confirm I7 --why "put in upside up"
    """
    from labos.cli._living import say_if_dead
    from labos.cli._out import show_json, show_table
    from labos.services.interventions import intervention_stories
    from labos.services.times import show_time

    with reading(where) as store:
        say_if_dead(where.url, store.head())
        told = [story for story in intervention_stories(store).values() if story.open]
    entries = [
        story
        for story in sorted(told, key=lambda story: story.due_at)
        if story.kind == PLANNED_WORK and module in (None, story.module)
    ]
    if as_json:
        show_json([_shown(story) for story in entries])
        return
    if not entries:
        click.echo("No work is planned for anybody now.")
        return
    rows = [
        [
            story.id,
            story.module,
            show_time(story.due_at) + (" (late)" if story.overdue else ""),
            story.run,
            story.text,
        ]
        for story in entries
    ]
    show_table(["id", "for", "due", "run", "work"], rows)
    click.echo("When it is done: labos confirm ID; if it cannot be done: labos confirm ID --not-done")


def _shown(story: InterventionStory) -> dict[str, Any]:
    names = ("id", "kind", "text", "run", "module", "requested_at", "due_at", "overdue")
    choices = [{"name": answer.name, "consequence": answer.consequence} for answer in story.answers]
    return {**{name: getattr(story, name) for name in names}, "choices": choices}


@click.command("confirm")
@click.argument("intervention", shell_complete=offering("intervention"))
@click.option("--not-done", is_flag=True, help="It cannot be done, and nothing was moved: the run ends.")
@why_option("A word about it for the log.")
@click.option("--result", metavar="JSON", help="What it gave, if later steps read it.")
@user_option
@home_option
@json_option
def confirm(
    intervention: str,
    not_done: bool,
    why: str,
    result: str | None,
    user: str | None,
    home: str | None,
    as_json: bool,
) -> None:
    """Say that the planned work INTERVENTION is done: it and what it did to the bench are logged.

    \b
    labos confirm I7
    labos confirm I7 --result '{"colour": "red"}' --why "a little spilt"
    labos confirm I7 --not-done --why "there is no foil left"
    """
    from labos.cli._lab import need_lab
    from labos.cli._out import tell
    from labos.errors import BadInput

    with need_lab(home) as client:
        questions = {q["id"]: q for q in client.state(waits=False)["interventions"]}
        asked = questions.get(intervention)
        if asked is not None and asked["kind"] != PLANNED_WORK:
            raise BadInput(
                f"{intervention} is no planned work but a question: {asked['text']}",
                remedy=f"Answer it with `labos resolve {intervention} CHOICE`.",
            )
        choice = "not_done" if not_done else "done"
        client.resolve(intervention, choice, who(user), why, _json(result))
    told = f"{intervention} is confirmed{' as not done' if not_done else ''}."
    tell(told, {"id": intervention, "choice": choice}, as_json=as_json)


def _json(text: str | None) -> Any:
    if text is None:
        return None
    try:
        return json.loads(text)
    except ValueError as error:
        raise click.BadParameter(f"{text!r} is not JSON ({error}).", param_hint="--result") from error
