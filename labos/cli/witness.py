"""``labos witness``: cosigns other labs' checkpoints."""

from __future__ import annotations

import asyncio
from pathlib import Path

import click

from labos.cli._remote import expect_folder
from labos.services.trust.keys import SigningKeys, read_given_keys
from labos.services.trust.witness import Witness


@click.command("witness", short_help="Cosign other labs' checkpoints.")
@click.option(
    "--public-key",
    "labs",
    multiple=True,
    required=True,
    metavar="KEY|FILE",
    help="The public key of a lab whose checkpoints are cosigned. May be repeated.",
)
@click.option("--host", default="127.0.0.1", show_default=True, help="The address to listen on.")
@click.option("--port", type=int, default=8790, show_default=True, help="The port to listen on; 0 for any.")
@click.option(
    "--home",
    envvar="LABOS_HOME",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("lab"),
    show_default=True,
    help="The folder of this lab, with its witness key and the checkpoints seen so far (keys/, witness/).",
    callback=expect_folder,
)
def command(labs: tuple[str, ...], host: str, port: int, home: Path) -> None:
    """Cosign checkpoints of other labs until Ctrl-C (C2SP tlog-witness). A checkpoint is signed only if it
    continues the lab's previous one. If a lab rewrites its log, or presents two different logs, it gets no
    more signatures.

    \b
    labos key create --witness --name chem.example.org/witness
    labos witness --public-key other-lab.pub --host 0.0.0.0

    A witness needs no log and controls no lab. Put a proxy with TLS in front of it (deploy/tls).
    """
    from labos.cli._lab import end_in_order
    from labos.http.witness import serve_witness

    witness = Witness(
        home / "witness", SigningKeys(home).read_signing_key(witness=True), read_given_keys(labs)
    )
    with end_in_order():
        try:
            asyncio.run(
                serve_witness(witness, host, port, lambda url: click.echo(f"The witness is at {url}."))
            )
        except KeyboardInterrupt:
            click.echo("The witness has ended.")
