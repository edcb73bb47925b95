"""``labos bus``: the bus by itself, so that it outlives the kernels."""

from __future__ import annotations

import asyncio

import click

LISTEN = "tcp/127.0.0.1:7447"


@click.command("bus")
@click.option(
    "--listen",
    multiple=True,
    metavar="ENDPOINT",
    default=(LISTEN,),
    show_default=True,
    help="Where kernels and nodes connect to.",
)
def command(listen: tuple[str, ...]) -> None:
    """Run the bus by itself until Ctrl-C. Kernels and nodes connect to it (`labos up --bus ENDPOINT`).

    Without it the kernel runs the bus, and nodes are cut off as long as there is no kernel. It keeps
    nothing: it may be stopped and started again at any time, and everybody finds their way back.
    A Zenoh router (zenohd) does as well.

    \b
    labos bus
    labos bus --listen tcp/0.0.0.0:7447
    """
    from labos.cli._lab import orderly
    from labos.telemetry.logs import configure_logs

    configure_logs("warning")
    with orderly():
        try:
            asyncio.run(_carry(listen))
        except KeyboardInterrupt:
            click.echo("The bus is closed.")


async def _carry(listen: tuple[str, ...]) -> None:
    from labos.bus import open_bus

    bus = await open_bus(mode="router", listen=listen)
    try:
        click.echo(f"The bus runs at {', '.join(listen)}. Ctrl-C closes it.")
        await asyncio.Event().wait()
    finally:
        await bus.close()
