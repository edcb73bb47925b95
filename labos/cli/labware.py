"""``labos labware``: the history of every plate."""

from __future__ import annotations

import click

from labos.cli._complete import make_completer
from labos.cli._liveness import open_current_log
from labos.cli._out import end_with_json, show_table
from labos.cli._query import Where, log_at_and_json
from labos.core.ids import local
from labos.errors import NotFound
from labos.services.describe import owner_name, shorten_value
from labos.services.history import find_position_at
from labos.services.labware import LabwareHistory, list_labware_histories, read_labware_history
from labos.services.times import Moment, show_span, show_time


@click.command("labware", short_help="List labware, or show the history of one piece.")
@click.argument("labware", shell_complete=make_completer("labware"), required=False, metavar="[ID]")
@click.option(
    "--gone/--here",
    default=None,
    help="Show only labware that has left the bench, or only labware that is still there.",
)
@click.option("--barcode", metavar="CODE", help="Labware with this barcode, also if it has left the bench.")
@log_at_and_json
def command(
    where: Where, labware: str | None, gone: bool | None, barcode: str | None, moment: Moment
) -> None:
    """List all labware. With an ID, show the history of one piece: its stations and times, its owners, and
    the actions on it with user and module. Each entry names the event in the log.

    \b
    labos labware                  all labware, also labware that has left the bench
    labos labware P7               the history of one plate
    labos labware P7 --at -1h      as it was known an hour ago
    labos labware --barcode LB0815   the piece with this barcode
    """
    with open_current_log(where, moment) as store:
        upto = find_position_at(store, moment)
        found = {} if labware else list_labware_histories(store, upto)
        story = read_labware_history(store, labware, upto) if labware else None
    if labware:
        if story is None:
            raise NotFound(f"There is no labware {labware!r} in this log.", remedy="List it: labos labware")
        end_with_json(story)
        _show_history(story)
        return
    shown = [s for s in found.values() if gone is None or bool(s.gone) == gone]
    if barcode is not None:
        shown = [s for s in shown if s.barcode == barcode]
        if not shown:
            raise NotFound(f"No labware has the barcode {barcode!r}.", remedy="List it: labos labware")
    end_with_json(shown)
    rows = [
        (
            s.id,
            s.type,
            s.barcode,
            s.place,
            "" if s.gone else owner_name(s.owner),
            show_time(s.stays[-1].since),
            show_time(s.stays[0].since),
        )
        for s in shown
    ]
    show_table(("id", "type", "barcode", "place", "of", "since", "first seen"), rows)


def _show_history(story: LabwareHistory) -> None:
    values = ", ".join(f"{name} = {shorten_value(value)}" for name, value in story.variables.items())
    last = "last " if story.gone else ""
    click.echo(f"{story.id} ({story.type}): {story.place}; {last}of {owner_name(story.owner)}")
    if story.barcode:
        click.echo(f"Barcode: {story.barcode}")
    if values:
        click.echo(f"Variables: {values}")
    stays = [
        (
            " or ".join(local(place) or "gone" for place in stay.places) or "gone",
            show_time(stay.since),
            show_time(stay.until),
            show_span((stay.until - stay.since) / 1e9) if stay.until else "",
            stay.by + (f"; {stay.note}" if stay.note else ""),
            str(stay.proof.position),
            stay.proof.hash[:16],
        )
        for stay in story.stays
    ]
    show_table(("place", "from", "to", "for", "by", "event", "hash"), stays, title="Stations", gap=True)
    changes = [
        (
            show_time(change.at),
            change.what,
            change.value if change.what == "owner" else shorten_value(change.value),
            change.by,
            str(change.proof.position),
            change.proof.hash[:16],
        )
        for change in story.changes
    ]
    show_table(("at", "what", "became", "by", "event", "hash"), changes, title="History", gap=True)
