"""Labware and material that people bring to the bench and take away: ``labos load``, ``unload``,
``replenish``."""

from __future__ import annotations

import click

from labos.cli._complete import make_completer
from labos.cli._options import Asker, asker_options
from labos.cli._out import end_with_json


@click.command("load")
@click.argument("station", shell_complete=make_completer("station"))
@click.option("--type", "labware", required=True, metavar="TYPE", help="The labware's type.")
@click.option(
    "--count", type=click.IntRange(min=1), default=1, show_default=True, help="The number of pieces."
)
@click.option("--lot", default="", help="The lot; each piece keeps it as its variable `lot`.")
@asker_options
def load(station: str, labware: str, count: int, lot: str, asker: Asker) -> None:
    """Report that you put labware on a stack, or on the lowest free shelves of a hotel.

    On a stack, new pieces are on top. A piece gets its id when it is taken from the stack. The command is
    refused if the station does not accept this type or has no room.

    \b
    labos load sciclops.tower1 --type pcr96 --count 20 --lot L2093
    """
    from labos.cli._lab import find_stations

    with asker.lab() as client:
        names = client.load(station, labware, asker.user, count=count, lot=lot)
        where = find_stations(client, names)
    end_with_json({"station": station, "type": labware, "count": count, "lot": lot, "labware": names})
    of_lot = f" of lot {lot}" if lot else ""
    pieces = [name if where.get(name, station) == station else f"{name} at {where[name]}" for name in names]
    called = f": {', '.join(pieces)}" if pieces else ""
    click.echo(f"{count} × {labware}{of_lot} loaded at {station}{called}.")


@click.command("unload")
@click.argument("station", shell_complete=make_completer("station"))
@click.argument("labware", shell_complete=make_completer("labware"), required=False)
@click.option("--count", type=click.IntRange(min=1), help="The number of pieces, from the top.")
@click.option("--all", "everything", is_flag=True, help="Unload everything that stands there.")
@asker_options
def unload(station: str, labware: str | None, count: int | None, everything: bool, asker: Asker) -> None:
    """Report that you took labware away from STATION: it has left the bench.

    Give the id of one piece, a number of pieces from the top, or --all. The command is refused if a run or
    an experiment still owns the labware. It also empties a waste.

    \b
    labos unload wc.output P7
    labos unload sciclops.tower1 --count 5
    labos unload wc.trash --all
    """
    if sum((labware is not None, count is not None, everything)) != 1:
        raise click.UsageError("Name one piece of labware, or --count N, or --all.")
    with asker.lab() as client:
        gone = client.unload(station, asker.user, labware=labware or "", count=count)
    end_with_json({"station": station, **gone})
    parts = [", ".join(gone["labware"])] if gone["labware"] else []
    parts += [f"{gone['nameless']} without an id"] if gone["nameless"] else []
    click.echo(f"Taken away from {station}: {' and '.join(parts)}.")


@click.command("replenish")
@click.argument("module", shell_complete=make_completer("module"))
@click.argument("resource")
@click.option("--amount", metavar="AMOUNT", help="The amount: 96, or 20mL [default: until full].")
@click.option("--lot", required=True, help="The lot of the new pack.")
@click.option("--expires", default="", metavar="DATE", help="The expiry date: 2027-05-31.")
@click.option("--instead", is_flag=True, help="The old pack was removed, with its remaining content.")
@asker_options
def replenish(
    module: str, resource: str, amount: str | None, lot: str, expires: str, instead: bool, asker: Asker
) -> None:
    """Report that you refilled RESOURCE in MODULE. Runs that wait for it continue.

    Consumption is taken from the oldest lot first. An expired lot is not used, unless the workcell file has
    `expired: warn`. Remove an expired lot, and report its replacement with --instead. `labos inventory`
    lists the resources, and when each of them runs out.

    \b
    labos replenish ot2_cp_gamma tips --amount 96 --lot T-0815 --expires 2027-05-31
    labos replenish sealer foil --lot F12                until it is full
    labos replenish sealer foil --lot F12 --instead      a new roll for the old one
    """
    with asker.lab() as client:
        number, unit = _parse_amount(amount)
        pack = {"amount": number, "unit": unit, "lot": lot, "expires": expires, "instead": instead}
        added = client.replenish(module, resource, asker.user, **pack)  # type: ignore[arg-type]
    end_with_json({"module": module, "resource": resource, "amount": added, "lot": lot, "expires": expires})
    click.echo(f"{added:g} of {resource} put into {module} (lot {lot}).")


def _parse_amount(text: str | None) -> tuple[float, str]:
    """``96`` or ``20mL``; 0 fills all free room. Raises click.BadParameter."""
    from labos.spec.durations import match_quantity

    if text is None:
        return 0.0, ""
    found = match_quantity(text)
    if found is None or not float(found[1]) > 0:
        raise click.BadParameter(f"{text!r} is not an amount: write 96, or 20mL.", param_hint="--amount")
    return float(found[1]), found[2] or ""
