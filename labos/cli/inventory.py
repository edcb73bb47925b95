"""``labos inventory``: the amounts that are left, and when they will be used up."""

from __future__ import annotations

import click
import msgspec

from labos.cli._liveness import open_current_log
from labos.cli._out import end_with_json, show_table
from labos.cli._query import Where, log_and_json, now_ns
from labos.core.ids import local
from labos.services.history import fold_state_at
from labos.services.inventory import (
    ResourceLeft,
    StackLeft,
    WasteLeft,
    count_inventory,
    list_shortfalls,
)
from labos.services.times import iso_time, show_time


@click.command("inventory", short_help="Show levels and lots of resources, and when they run out.")
@log_and_json
def command(where: Where) -> None:
    """Show levels and lots of all resources, the content of stacks, the room in wastes, and when each of them
    runs out.

    LabOS simulates the open runs in their order with nominal durations. For each resource, it names the
    first run that would find too little, and the time. If runs wait for a person, the time is later.

    \b
    labos inventory
    labos inventory --json
    """
    with open_current_log(where) as store:
        state = fold_state_at(store)
    now = max(now_ns(), state.recorded_at)
    found = count_inventory(state, now, iso_time(now)[:10])
    end_with_json({"position": state.position, "time": iso_time(now), **msgspec.structs.asdict(found)})
    show_table(
        ("resource", "left", "of", "still needed", "lots", "runs out"),
        [_list_resource_cells(left) for left in found.resources],
        title=f"At {show_time(now)}; {found.runs_looked_at} open runs",
    )
    show_table(
        ("stack", "left", "of", "still needed", "top to bottom", "runs out"),
        [_list_stack_cells(left) for left in found.stacks],
        gap=True,
    )
    if found.wastes:
        show_table(
            ("waste", "room", "of", "still to come", "full"),
            [_list_waste_cells(left) for left in found.wastes],
            gap=True,
        )
    first = list_shortfalls(found)
    if first:
        name, out = first[0]
        short = local(name).replace(":", " ")
        click.echo(f"\nFirst: {short} at {show_time(out.at)}, in run {out.run} ({out.step!r}).")


def _list_resource_cells(left: ResourceLeft) -> tuple[str, ...]:
    unit = f" {left.unit}" if left.unit else ""
    lots = [
        f"{lot.lot or 'no lot'}: {lot.left:g}"
        + (f" ({'EXPIRED' if lot.expired else 'until'} {lot.expires})" if lot.expires else "")
        for lot in left.lots
    ]
    out = left.runs_out
    return (
        f"{local(left.module)} {left.resource}",
        f"{left.level:g}{unit}",
        f"{left.capacity:g}{unit}",
        f"{left.promised:g}",
        ", ".join(lots),
        f"{show_time(out.at)}, run {out.run}" if out else "",
    )


def _list_stack_cells(left: StackLeft) -> tuple[str, ...]:
    pieces = [f"{c.count} × {c.type}" + (f" (lot {c.lot})" if c.lot else "") for c in left.contents]
    out = left.runs_out
    return (
        local(left.station),
        str(left.count) if left.known else "unknown",
        str(left.capacity),
        str(left.promised),
        ", ".join(pieces),
        f"{show_time(out.at)}, run {out.run}" if out else "",
    )


def _list_waste_cells(left: WasteLeft) -> tuple[str, ...]:
    out = left.runs_out
    when = f"{show_time(out.at)}, run {out.run}" if out else ""
    return (local(left.station), str(left.room), str(left.capacity), str(left.promised), when)
