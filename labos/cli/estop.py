"""``labos estop``: stops modules at once, in an emergency."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from labos.cli._complete import make_completer
from labos.cli._options import Asker, asker_options, cert_option
from labos.cli._out import show_json, wants_json
from labos.cli._remote import lab_of
from labos.errors import BadInput, BusError, NotFound
from labos.settings import Settings, find_kernel, last_kernel

PATIENCE_S = 2.0
"""How long the search for a kernel may take before the nodes are stopped without it."""


@click.command("estop")
@click.argument(
    "target", shell_complete=make_completer("module", "workcell"), required=False, metavar="[MODULE|WORKCELL]"
)
@click.option("--all", "everything", is_flag=True, help="Stop every module of the lab.")
@click.option(
    "--connect",
    multiple=True,
    metavar="ENDPOINT",
    help="Send the stop directly over this bus, not to the kernel.",
)
@cert_option
@asker_options
def command(
    target: str | None, everything: bool, connect: tuple[str, ...], cert: Path | None, asker: Asker
) -> None:
    """Stop a MODULE, a WORKCELL or everything at once, in an emergency.

    The stop waits neither for the log nor for other requests, and no node refuses it. It is logged
    afterwards, with the user. A stopped module is in the state ERROR until `labos reset`. If no kernel
    answers, the command goes directly to the nodes over the bus. Exit code 0 only if every module reports
    that it has stopped.

    This command is not a safety function. If people can be hurt, use the hardware's emergency stop.

    \b
    labos estop pf400
    labos estop rpl
    labos estop --all
    """

    if (target is None) is not everything:
        raise click.UsageError("Name one module or workcell, or give --all.")
    report = _stop(target or "*", connect, cert, asker.user, asker.home)
    stopped, silent = sorted(report["stopped"]), report["silent"]
    if wants_json():
        show_json(report)
    else:
        for module in stopped:
            click.echo(f"{module} is stopped.")
        for module, why in sorted(silent.items()):
            click.echo(f"{module} is NOT known to be stopped: {why.rstrip('.')}. Stop it by hand.", err=True)
    if silent or not stopped:
        if not silent:
            click.echo("No node is running, so none can be stopped.", err=True)
        raise click.exceptions.Exit(1)


def _stop(
    target: str, connect: Sequence[str], cert: Path | None, by: str, home: str | None
) -> dict[str, Any]:
    """Stop through the kernel, else directly at the nodes. Raises NotFound, BusError."""
    from labos.client import LabClient, LabUnreachable
    from labos.pki import Authority, PartyIdentity

    if not connect and (url := lab_of(home)):
        with LabClient(url, patience_s=PATIENCE_S) as client:
            return client.emergency_stop(target, by)
    folder = Settings.make(home).home
    last = last_kernel(folder)
    if not connect and find_kernel(folder) is not None:
        try:
            with LabClient(home=folder, patience_s=PATIENCE_S) as client:
                return client.emergency_stop(target, by)
        except LabUnreachable as error:
            click.echo(f"labos: {error.message} The stop is sent directly to the nodes.", err=True)
    if not connect and last is None:
        raise NotFound(f"No lab has run in {folder}.", remedy="Name its --home, or the bus with --connect.")
    if connect or last is None:
        return _stop_without_kernel(connect, cert, target, by)
    if cert is None and last.bus.startswith("tls/"):
        cert = Authority(Settings.make(home).pki).credentials(PartyIdentity("kernel", lab=last.lab)).folder
    return _stop_without_kernel((last.bus,), cert, target, by, last.lab)


def _stop_without_kernel(
    connect: Sequence[str], cert: Path | None, target: str, by: str, lab: str = "*"
) -> dict[str, Any]:
    import msgspec

    from labos.bootstrap import stop_over_bus

    try:
        report = asyncio.run(stop_over_bus(connect, target, by, lab, cert))
    except (BusError, BadInput) as error:
        raise BusError(
            f"Nothing was stopped: {error.message}",
            remedy=f"Use the hardware's emergency stop. {error.remedy}".rstrip(),
        ) from error
    found: dict[str, Any] = msgspec.to_builtins(report)
    return found
