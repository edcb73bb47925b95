"""``labos erase``: deletes words of people; the log stays intact."""

from __future__ import annotations

from typing import Any

import click

from labos.cli._options import Asker, asker_options
from labos.cli._out import end_with_json, report_done, show_table
from labos.cli._query import Where
from labos.cli._remote import lab_of
from labos.core.erasure import REASONS
from labos.services.times import show_time
from labos.settings import Settings


@click.command("erase", short_help="Erase texts that people wrote: reasons, notes, comments.")
@click.argument("records", metavar="[POSITION]...", nargs=-1, type=click.IntRange(min=1))
@click.option("--for", "author", metavar="USER", help="Erase all texts of this user.")
@click.option(
    "--because", metavar="CODE", type=click.Choice(list(REASONS)), help="The reason: one of the codes above."
)
@click.option("--approve", metavar="ID", help="Approve a request, as the second person.")
@click.option("--refuse", metavar="ID", help="Refuse a request that waits.")
@asker_options
def command(
    records: tuple[int, ...],
    author: str | None,
    because: str | None,
    approve: str | None,
    refuse: str | None,
    asker: Asker,
) -> None:
    """Erase the texts of the events at these positions of the log, or all texts of a user. The events stay in
    the log, with `(erased)` in place of the texts. The log, its checkpoints and bundles verify as before. An
    event records the erasure with user, time, positions and reason. An erasure cannot be undone.

    \b
    labos log --user bo                          find the position
    labos erase 120 --because personal
    labos erase --for bo --because request
    labos erase                                  list requests that wait for a second person
    labos erase --approve X1

    Codes: request (by the author, or by the person concerned), personal (personal data that does not belong
    there), secret (a password or confidential information), mistake (written in the wrong place), retention
    (the retention period is over), order (ordered by a court or an authority).

    Names, tags and arguments of steps cannot be erased. Neither can texts from before LabOS stored texts
    beside the log. Copies outside the lab are not changed: bundles, exports, sent messages. Backups lose the
    texts with the next `labos backup`. SQL tables on another computer lose them with their next update
    (`labos audit project`).
    """
    from labos.cli._audit import forget_erased

    asks = bool(records) + bool(author) + bool(approve) + bool(refuse)
    if asks > 1:
        raise click.UsageError("Give exactly one of: positions, --for, --approve, --refuse.")
    if bool(because) != bool(records or author):
        raise click.UsageError("--because CODE is needed with positions or --for USER, and only there.")
    with asker.lab() as client:
        if refuse:
            client.refuse_erasure(refuse, asker.user)
            report_done(f"{refuse} was refused.", {"erasure": refuse})
            return
        if not asks:
            _show(client.erasures())
            return
        if approve:
            done = client.approve_erasure(approve, asker.user)
        else:
            assert because is not None
            done = client.erase_words(because, asker.user, records=list(records), user=author or "")
    if done["erased"] and not lab_of(asker.home):
        forget_erased(Where(Settings.make(asker.home).home))
    report_done(_describe_erasure(done), done)


def _describe_erasure(done: dict[str, Any]) -> str:
    if done["erasure"]:
        return (
            f"{done['erasure']} waits for a second person, by the lab's policy: "
            f"labos erase --approve {done['erasure']}"
        )
    texts = "1 text was" if done["erased"] == 1 else f"{done['erased']} texts were"
    message = f"{texts} erased; position {done['position']} of the log records this."
    if done["left"]:
        message += f"\nTraces may still be in the database's files: {done['left']}."
    return message


def _show(waiting: list[dict[str, Any]]) -> None:
    end_with_json(waiting)
    if not waiting:
        click.echo("No request waits for a second person.")
    else:
        rows = [
            (
                each["erasure"],
                f"all texts of {each['user']}" if each["user"] else ", ".join(map(str, each["records"])),
                each["because"],
                each["by"],
                show_time(each["asked_at"]),
            )
            for each in waiting
        ]
        show_table(("id", "positions", "because", "by", "since"), rows)
