"""``labos bus``: the bus in a separate process, so that it continues without a kernel."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

import click

from labos.cli._options import address_option, folder_option, home_option, pki_option
from labos.settings import Settings, keep_private
from labos.telemetry.logs import configure_logs

if TYPE_CHECKING:
    from labos.bootstrap import Guard

LISTEN = "127.0.0.1:7447"


@click.command("bus")
@click.option(
    "--listen",
    multiple=True,
    metavar="ENDPOINT",
    help=f"The address to which kernels and nodes connect (tcp/{LISTEN}, tls/{LISTEN} with --secure).",
)
@click.option(
    "--secure",
    is_flag=True,
    help="Use TLS and certificates: each node and kernel can send only its own messages.",
)
@folder_option(
    "--cert",
    help="The folder of this bus (`labos pki issue bus`), if the certificate authority is elsewhere.",
)
@address_option
@pki_option
@home_option
def command(
    listen: tuple[str, ...],
    secure: bool,
    cert: Path | None,
    address: tuple[str, ...],
    pki: Path | None,
    home: str | None,
) -> None:
    """Run only the bus until Ctrl-C. Kernels and nodes connect to it (`labos up --bus ENDPOINT`).

    Without this command the bus is part of the kernel: while no kernel runs, nodes have no connection. The
    bus stores nothing. You can stop and start it at any time; kernels and nodes reconnect. A Zenoh router
    (zenohd) can take its place.

    With --secure, the bus accepts only certificates of the lab's certificate authority. It applies new and
    revoked certificates within two seconds (docs/secure-bus.md).

    \b
    labos bus
    labos bus --listen tcp/0.0.0.0:7447
    labos bus --secure --listen tls/0.0.0.0:7447 --address bus.example.org --home /var/lib/labos
    """
    from labos.bootstrap import Guard
    from labos.cli._lab import end_in_order
    from labos.pki import PartyIdentity

    configure_logs("warning")
    guard = None
    if secure or cert is not None:
        keep_private()
        settings = Settings.make(home, addresses=address, authority=pki)
        own = cert.absolute() if cert is not None else None
        guard = Guard(PartyIdentity("bus"), settings, runs_bus=True, own=own)
    where = listen or (f"{'tls' if guard is not None else 'tcp'}/{LISTEN}",)
    with end_in_order():
        try:
            asyncio.run(_carry(where, guard))
        except KeyboardInterrupt:
            click.echo("The bus is closed.")


async def _carry(listen: tuple[str, ...], guard: Guard | None) -> None:
    from labos.bus import open_bus

    security = await asyncio.to_thread(guard.prepare) if guard is not None else None
    bus = await open_bus(mode="router", listen=listen, security=security)
    try:
        if guard is not None:
            await guard.watch(bus)
        click.echo(f"The bus runs at {', '.join(listen)}. Ctrl-C closes it.")
        await asyncio.Event().wait()
    finally:
        if guard is not None:
            await guard.close()
        await bus.close()
