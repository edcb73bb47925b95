"""``labos api``: the HTTP interface in a separate process."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from labos.cli._options import (
    cert_option,
    database_option,
    home_option,
    pki_option,
    refuse_password,
    web_options,
)
from labos.settings import Settings, keep_private
from labos.telemetry.logs import configure_logs

if TYPE_CHECKING:
    from labos.bootstrap import ApiSettings


@click.command("api")
@home_option
@database_option
@click.option(
    "--accounts",
    metavar="URL",
    envvar="LABOS_ACCOUNTS_URL",
    callback=refuse_password,
    help="The database with passwords, tokens and sessions (LABOS_ACCOUNTS_URL; that of the log). Needed "
    "where --database is a read-only replica.",
)
@click.option(
    "--process",
    "name",
    default="api",
    metavar="NAME",
    show_default=True,
    help="The name of this process: each API process of a lab has its own.",
)
@click.option("--http-port", type=int, help="The port of the HTTP interface (a free port if not given).")
@click.option(
    "--host", default="127.0.0.1", show_default=True, help="The address on which this process listens."
)
@web_options("this process")
@click.option(
    "--bus", multiple=True, metavar="ENDPOINT", help="The lab's bus (that of the kernel that runs in --home)."
)
@cert_option
@pki_option
def command(
    home: str | None,
    database: str | None,
    accounts: str | None,
    name: str,
    cert: Path | None,
    pki: Path | None,
    **as_set: Any,
) -> None:
    """Serve the HTTP interface of a running lab until Ctrl-C, beside the kernel's own.

    This process follows the log, answers requests from it, and checks users' credentials. It forwards
    requests that change something to the kernel. Several such processes may run, each with its own name
    and port. They take load off the kernel. On the kernel's computer, --home is enough. On another
    computer, the log has to be on PostgreSQL (--database may be a read-only replica, with --accounts), and
    the bus has to be secure (`labos pki issue api NAME`, then --cert and --bus). See
    docs/api-processes.md.

    \b
    labos api --http-port 8721
    labos api --process api-2 --http-port 8722
    labos api --process web --bus tls/kernel.example.org:7447 --cert api.web --host 0.0.0.0 --behind-proxy
    """
    from labos.bootstrap import ApiSettings
    from labos.cli._lab import end_in_order

    configure_logs("warning")
    keep_private()
    settings = Settings.make(
        home,
        database,
        secure=True if cert is not None else None,
        certificate=cert.absolute() if cert is not None else None,
        authority=pki,
        **as_set,
    )
    with end_in_order():
        try:
            asyncio.run(_serve(ApiSettings(settings, name, accounts or "")))
        except KeyboardInterrupt:
            click.echo("The API process is closed.")


async def _serve(settings: ApiSettings) -> None:
    from labos.bootstrap import open_api

    async with open_api(settings) as api:
        click.echo(f"The API process {settings.name} serves the lab {api.kernel.lab}.")
        click.echo(f"  http  {api.http.url}\nCtrl-C closes it.")
        await asyncio.Event().wait()
