"""``labos provenance``: the origin of something, and everything that was derived from it."""

from __future__ import annotations

import click

from labos.audit._facts import describe_entity
from labos.audit.formats import as_dot, as_prov
from labos.audit.graph import Entity, Graph, ProvenancePart
from labos.audit.provenance import MOST_LINKS, subject_of, trace
from labos.cli._audit import open_log_and_views
from labos.cli._out import show_json, show_table, wants_json
from labos.cli._query import Where, at_option, folder_options, json_option
from labos.services.describe import shorten_value
from labos.services.history import find_position_at
from labos.services.times import Moment


@click.command("provenance")
@click.argument("subject")
@click.option(
    "--up", "direction", flag_value="up", default="up", help="Show from what it was derived (default)."
)
@click.option("--down", "direction", flag_value="down", help="Show what was derived from it, for a recall.")
@click.option("--only", metavar="KIND", help="Only entries of this kind: result, run, lot, user …")
@click.option(
    "--most",
    type=click.IntRange(min=1),
    default=MOST_LINKS,
    show_default=True,
    help="The maximum number of links to follow.",
)
@json_option
@click.option("--prov", "as_prov_json", is_flag=True, help="Print W3C PROV-JSON (extra `provenance`).")
@click.option("--dot", "as_graphviz", is_flag=True, help="Print a graph for Graphviz.")
@at_option
@folder_options
def command(
    where: Where,
    subject: str,
    direction: str,
    only: str | None,
    most: int,
    as_prov_json: bool,
    as_graphviz: bool,
    moment: Moment,
) -> None:
    """Show the provenance of labware (P7), a well (P7/B7), a run (R1), the result of a step (R1#3), a
    sample, a file (its digest), or a lot: user, time, workflow, driver, arguments and lots.

    For a well, show also its content: LabOS follows every transfer since it was filled back to lots and
    samples. If a name is ambiguous, write `lot:NAME`, `sample:NAME`, `user:NAME` and so on.

    \b
    labos provenance R1#3                        from what a result was derived
    labos provenance P7/B7 --at -1h              the content of a well an hour ago
    labos provenance lot:L42 --down --only result   which results depend on a lot
    """
    if sum((wants_json(), as_prov_json, as_graphviz)) > 1:
        raise click.UsageError("Choose one of --json, --prov and --dot.")
    with open_log_and_views(where) as (store, asker):
        upto = find_position_at(store, moment)
        entity = subject_of(asker, subject, upto)
        graph = trace(asker, entity, upto, "down" if direction == "down" else "up", most)
        lab = store.head().lab
    if wants_json():
        show_json(graph)
    elif as_prov_json:
        click.echo(as_prov(graph, lab))
    elif as_graphviz:
        click.echo(as_dot(graph))
    elif only:
        _list(graph, only, direction)
    else:
        _show_graph(graph)
    if not graph.whole:
        click.echo(f"There is more than {most} links: --most follows more.", err=True)


def _show_graph(graph: Graph) -> None:
    click.echo(f"{_write_label(graph, str(graph.subject))}, at event {graph.position}")
    for name, value in graph.facts.items():
        if value != []:
            click.echo(f"  {name}: {value if isinstance(value, str) else shorten_value(value)}")
    if graph.contents:
        rows = [_list_part_cells(part) for part in graph.contents]
        show_table(("origin", "liquid", "volume", "share", "certain"), rows, title="Contents", gap=True)
    rows = [
        (
            str(link.position),
            _write_label(graph, str(link.effect)),
            link.relation,
            _write_label(graph, str(link.cause)),
        )
        for link in graph.links
    ]
    show_table(("event", "what", "", "of what"), rows, title="Links", gap=True)


def _list(graph: Graph, kind: str, direction: str) -> None:
    """The entities of one kind, each once, with the event that names it."""
    found: dict[str, int] = {}
    for link in graph.links:
        entity = link.cause if direction == "up" else link.effect
        if entity.kind == kind:
            found.setdefault(str(entity), link.position)
    rows = []
    for name, position in found.items():
        facts = graph.entities.get(name, {})
        when = str(facts.get("ended_at") or facts.get("submitted_at") or facts.get("placed_at") or "")
        rows.append((str(position), _write_label(graph, name), str(facts.get("run", "")), when))
    show_table(("event", "what", "run", "when"), rows)


def _write_label(graph: Graph, name: str) -> str:
    kind, _, rest = name.partition(" ")
    facts = graph.facts if name == str(graph.subject) else graph.entities.get(name, {})
    return describe_entity(Entity(kind, rest), facts)  # type: ignore[arg-type]


def _list_part_cells(part: ProvenancePart) -> tuple[str, ...]:
    volume = "" if part.volume_ul is None else f"{part.volume_ul:.6g} µL"
    share = "" if part.share is None else f"{part.share:.2%}"
    return (str(part.origin), part.what, volume, share, "yes" if part.certain else "no")
