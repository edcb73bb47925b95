"""``labos find``: finds experiments, runs, samples, images, results and publications by words."""

from __future__ import annotations

from typing import Any

import click
import msgspec

from labos.audit._entry_tables import KINDS
from labos.audit.find import FACETS, MOST_FOUND, SearchQuery, SearchResult, find
from labos.cli._audit import open_views
from labos.cli._out import end_with_json, show_table
from labos.cli._query import Where, as_time, log_and_json
from labos.client import LabClient
from labos.services.times import parse_time, show_time


@click.command("find", short_help="Find experiments, runs, samples, images and results by words.")
@click.argument("words", nargs=-1)
@click.option("--kind", multiple=True, type=click.Choice(KINDS), help="Only entries of this kind.")
@click.option("--user", multiple=True, metavar="ID", help="Only entries of this user.")
@click.option("--workcell", multiple=True, metavar="NAME", help="Only entries of this workcell.")
@click.option(
    "--workflow", multiple=True, metavar="NAME", help="Only entries of this workflow or application."
)
@click.option("--experiment", multiple=True, metavar="ID", help="Only entries of this experiment.")
@click.option("--status", multiple=True, metavar="STATUS", help="Only entries with this status.")
@click.option("--keyword", multiple=True, metavar="WORD", help="Only entries with this keyword or quantity.")
@click.option("--since", metavar="TIME", callback=as_time, help="Only entries from this time on.")
@click.option("--until", metavar="TIME", callback=as_time, help="Only entries before this time.")
@click.option("--facets", is_flag=True, help="Count the entries for each user, workcell, month ….")
@click.option(
    "--last",
    "limit",
    type=click.IntRange(0, MOST_FOUND),
    default=20,
    show_default=True,
    metavar="N",
    help="Show the newest N entries.",
)
@click.option("--offset", type=click.IntRange(0), default=0, metavar="N", help="Skip the first N entries.")
@log_and_json
def command(where: Where, words: tuple[str, ...], facets: bool, **options: Any) -> None:
    """Find entries that have all these WORDS: experiments, runs, samples, images, files, results of steps,
    and publications of applications. Without words, list all entries that match the options.

    `colo*` matches all words with this beginning. Capital letters and accents do not matter. Entries with
    the words in their name come first, then the newest ones. If you give an option twice, either value
    matches.

    \b
    labos find color picker
    labos find "absorb*" --kind result --user ada --since -30d
    labos find --facets --last 0
    labos find P7 --kind image --json
    """
    since, until = options.pop("since") or 0, options.pop("until") or 0
    question = SearchQuery(words=" ".join(words), since=since, until=until, facets=facets, **options)
    if where.lab:
        with LabClient(where.lab) as client:
            asked = msgspec.structs.asdict(question)
            del asked["hidden"]  # the lab knows which campaigns the user sees
            found = msgspec.convert(client.find(**asked), SearchResult)
    else:
        with open_views(where) as asker:
            found = find(asker, question)
    end_with_json(found)
    _show(found, question)


def _show(found: SearchResult, question: SearchQuery) -> None:
    if found.entries:
        rows = [
            (
                entry.kind,
                entry.name[:12] + "…" if len(entry.name) == 64 else entry.name,
                entry.title,
                entry.user,
                entry.workcell,
                entry.status,
                show_time(parse_time(entry.at, 0)),
            )
            for entry in found.entries
        ]
        show_table(("kind", "name", "title", "user", "workcell", "status", "when"), rows)
    last = question.offset + len(found.entries)
    if found.total > last and found.entries:
        click.echo(f"{question.offset + 1} to {last} of {found.total}; the next ones: --offset {last}")
    else:
        click.echo("No entry matches." if not found.total else f"{found.total} found.")
    for facet in FACETS if question.facets else ():
        values = ", ".join(f"{value.value} {value.count}" for value in found.facets[facet])
        if values:
            click.echo(f"{facet + ':':12} {values}")
    if found.behind:
        click.echo(f"The last {found.behind} events are not in the search index yet. Repeat the command.")
