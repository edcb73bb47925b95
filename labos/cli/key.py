"""``labos key``: the keys that sign a lab's checkpoints."""

from __future__ import annotations

import click

from labos.cli._group import Suggesting
from labos.cli._out import end_with_json, report_done
from labos.cli._query import Where, find_lab_id, folder_and_json, now_ns
from labos.errors import NotFound
from labos.services.times import iso_time
from labos.services.trust.keys import SigningKeys
from labos.services.trust.tree import read_tree

witness_option = click.option(
    "--witness",
    is_flag=True,
    help="Use the key that cosigns other labs' checkpoints, not the lab's own key.",
)


@click.group("key", cls=Suggesting, short_help="Manage the keys that sign the lab's checkpoints.")
def command() -> None:
    """Manage the key pair that signs this lab's checkpoints (Ed25519).

    The private key stays in the lab's folder, in keys/. Only the folder's owner can read it. Give the public
    key to people who check the lab's records. Send it by another way than the records.

    \b
    labos key create    create the key pair
    labos key show      print the public key
    labos key rotate    replace the key pair
    """


@command.command("create")
@click.option(
    "--name",
    metavar="NAME",
    help="The name of the key, such as chem.example.org/lab1 (default: labos/ and the id of the lab).",
)
@witness_option
@folder_and_json
def create(where: Where, name: str | None, witness: bool) -> None:
    """Create the key pair. This is done once. Its name is in each checkpoint and identifies the lab."""
    public = SigningKeys(where.home).create(name or _own_name(where, witness), witness=witness)
    report_done(public.text, {"public_key": public.text, "name": public.name})


@command.command("show")
@witness_option
@folder_and_json
def show(where: Where, witness: bool) -> None:
    """Print the public key. --json also shows the keys that it replaced."""
    keys = SigningKeys(where.home)
    if witness:
        text = keys.read_signing_key(witness=True).public.text
        report_done(text, {"public_key": text})
        return
    known = keys.list_public_keys()
    if not known:
        raise NotFound("This lab has no key.", remedy="Make one: labos key create")
    end_with_json({"public_key": known[-1].text, "earlier": [key.text for key in known[:-1]]})
    click.echo(known[-1].text)


@command.command("rotate")
@folder_and_json
def rotate(where: Where) -> None:
    """Replace the key pair. The old private key signs the new public key and is then destroyed. Bundles
    contain this signature, so a person with the old public key can still check them."""
    size = read_tree(where.home).size
    keys = SigningKeys(where.home)
    keys.rotate(size, iso_time(now_ns()))
    public = keys.list_public_keys()[-1]
    end_with_json({"public_key": public.text, "size": size})
    click.echo(public.text)
    click.echo(
        f"The old key signs nothing after position {size}. Give the new public key to people who "
        "check the log."
    )


def _own_name(where: Where, witness: bool) -> str:
    if not (lab := find_lab_id(where)):
        raise click.UsageError("There is no log yet, and so no default name for the key: give --name NAME.")
    return f"labos/{lab}/witness" if witness else f"labos/{lab}"
