"""Observations on the bench, and the owners of labware."""

from __future__ import annotations

import click

from labos.cli._complete import make_completer
from labos.cli._options import (
    Asker,
    asker_options,
    home_option,
    json_option_saying,
    user_option,
    why_option,
)
from labos.cli._out import end_with_json, report_done
from labos.core.ids import local


@click.command("observe")
@click.argument("station", shell_complete=make_completer("station"))
@click.argument("what", required=False, default="")
@json_option_saying("Print the consequences as JSON, for programs.")
@user_option
@home_option
def observe(station: str, what: str, user: str, home: str | None) -> None:
    """Report an observation at STATION. WHAT is `empty`, the number of pieces, an id or barcode of labware,
    or a labware type. Without WHAT you report that something stands there.

    If the lab does not know where a piece of labware stands, each station that is observed empty excludes
    one possible place. As soon as the piece is observed, the lab's question about it is auto-resolved. An
    observation that contradicts the log opens a question. Only runs that need this labware wait for it.

    \b
    labos observe pf400.gripper empty
    labos observe sealer.default P7
    labos observe wc.shelf plate96
    labos observe sciclops.tower1 4
    """
    from labos.cli._lab import need_lab

    with need_lab(home) as client:
        follows = client.observe(station, what, user)
    end_with_json(follows)
    for labware, place in follows["found"].items():
        click.echo(f"{labware} stands at {local(place)}.")
    for labware in follows["gone"]:
        click.echo(f"{labware} is off the bench.")
    for labware, places in follows["uncertain"].items():
        click.echo(f"{labware} may be at: {', '.join(local(p) or 'gone' for p in places)}.")
    for question in follows["answered"]:
        click.echo(f"{question} is auto-resolved.")
    for asked in follows["asked"]:
        click.echo(f"{asked['id']}  {asked['text']}")
        for offered in asked["choices"]:
            click.echo(f"      labos resolve {asked['id']} {offered['name']}   {offered['consequence']}")
    if not any(follows[name] for name in ("found", "gone", "uncertain", "answered", "asked")):
        click.echo(f"Recorded: {local(follows['station'])}, {what or 'something stands there'}.")


@click.command("give")
@click.argument("labware", shell_complete=make_completer("labware"))
@click.option(
    "--to",
    type=click.Choice(["user", "experiment", "shared"]),
    required=True,
    help="The new owner: user NAME, experiment ID, or shared for everybody.",
)
@click.argument("name", required=False, default="")
@click.option("--force", is_flag=True, help="For operators: give labware that is not yours; needs --why.")
@why_option("A note for the log.")
@asker_options
def give(labware: str, to: str, name: str, force: bool, why: str, asker: Asker) -> None:
    """Give LABWARE to a new owner. From then on the new owner's runs may use it, and yours may not.

    The command is refused if the labware is not yours, if a run uses it, or if an action on it is in
    progress.

    \b
    labos give P7 --to user bob
    labos give P7 --to experiment E3
    labos give P7 --to shared
    labos give P7 --to user bob --force --why "ada has left"
    """
    if (to == "shared") == bool(name):
        raise click.UsageError("Give --to user NAME, --to experiment ID, or --to shared.")
    with asker.lab() as client:
        owner = f"{to}:{name}" if name else to
        client.give(labware, owner, asker.user, force=force, note=why)
    message = f"{labware} belongs to {f'{to} {name}' if name else 'everybody'}."
    report_done(message, {"labware": labware, "owner": owner})
