"""``labos inbox`` and ``labos confirm``: planned work for people."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from labos.cli._complete import make_completer
from labos.cli._liveness import open_current_log
from labos.cli._options import Asker, asker_options, read_result, why_option
from labos.cli._out import end_with_json, report_done, show_table
from labos.cli._query import Where, log_and_json
from labos.core.topics import PlannedWork
from labos.errors import BadInput
from labos.services.interventions import list_intervention_histories
from labos.services.times import show_time

if TYPE_CHECKING:
    from labos.services.interventions import InterventionHistory


@click.command("inbox")
@click.option(
    "--module",
    shell_complete=make_completer("module"),
    metavar="NAME",
    help="Only the work of this operator module.",
)
@log_and_json
def inbox(where: Where, module: str | None) -> None:
    """List planned work that waits for a person, the most urgent first.

    Each entry is a step of a run on an operator module. The run continues when a person confirms the step.
    Late work stays in the inbox. No run fails because of it.

    \b
    labos inbox
    labos confirm I7 --why "put in upside up"
    """
    with open_current_log(where) as store:
        stories = [story for story in list_intervention_histories(store).values() if story.open]
    entries = [
        story
        for story in sorted(stories, key=lambda story: story.due_at)
        if story.kind == PlannedWork.KIND and module in (None, story.module)
    ]
    end_with_json([_as_json(story) for story in entries])
    asked = [story.id for story in stories if story.kind != PlannedWork.KIND]
    if not entries:
        click.echo("No planned work waits now.")
        _show_open_questions(asked)
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
    click.echo("When the work is done: labos confirm ID. If it cannot be done: labos confirm ID --not-done")
    _show_open_questions(asked)


def _show_open_questions(asked: list[str]) -> None:
    """Questions that wait for a person and are not planned work."""
    if asked:
        click.echo(f"Other open questions: {', '.join(asked)}. See: labos interventions")


def _as_json(story: InterventionHistory) -> dict[str, Any]:
    names = ("id", "kind", "text", "run", "module", "requested_at", "due_at", "overdue")
    choices = [{"name": answer.name, "consequence": answer.consequence} for answer in story.answers]
    return {**{name: getattr(story, name) for name in names}, "choices": choices}


@click.command("confirm")
@click.argument("intervention", shell_complete=make_completer("intervention"))
@click.option(
    "--not-done", is_flag=True, help="The work cannot be done, and nothing was moved: the run ends."
)
@why_option("A note for the log.")
@click.option("--result", metavar="JSON", help="The result of the work, if later steps read it.")
@asker_options
def confirm(intervention: str, not_done: bool, why: str, result: str | None, asker: Asker) -> None:
    """Confirm that the planned work INTERVENTION is done. LabOS logs it with its effects on the bench.

    \b
    labos confirm I7
    labos confirm I7 --result '{"colour": "red"}' --why "a little spilt"
    labos confirm I7 --not-done --why "there is no foil left"
    """
    with asker.lab() as client:
        questions = {q["id"]: q for q in client.state(waits=False)["interventions"]}
        asked = questions.get(intervention)
        if asked is not None and asked["kind"] != PlannedWork.KIND:
            raise BadInput(
                f"{intervention} is not planned work but a question: {asked['text']}",
                remedy=f"Answer it with `labos resolve {intervention} CHOICE`.",
            )
        choice = "not_done" if not_done else "done"
        client.resolve(intervention, choice, asker.user, why, read_result(result))
    message = f"{intervention} is confirmed{' as not done' if not_done else ''}."
    report_done(message, {"id": intervention, "choice": choice})
