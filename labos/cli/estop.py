"""``labos estop``: stop at once, in an emergency."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

import click

from labos.cli._complete import offering
from labos.cli._options import home_option, json_option, user_option, who

PATIENCE_S = 2.0
"""How long a kernel may take to be found before the nodes are told without it."""


@click.command("estop")
@click.argument(
    "target", shell_complete=offering("module", "workcell"), required=False, metavar="[MODULE|WORKCELL]"
)
@click.option("--all", "everything", is_flag=True, help="Every module of the lab.")
@click.option("--connect", multiple=True, metavar="ENDPOINT", help="Straight over this bus, past the kernel.")
@user_option
@home_option
@json_option
def command(
    target: str | None,
    everything: bool,
    connect: tuple[str, ...],
    user: str | None,
    home: str | None,
    as_json: bool,
) -> None:
    """Stop a MODULE, a WORKCELL or everything at once, in an emergency.

    It waits for nothing: not for the log, not for its turn, and no node refuses it. Who stopped
    what is written down afterwards. A stopped module is in ERROR until `labos reset`. Without a
    kernel that answers, the nodes are told over the bus. Exit code 0 only if every module says
    that it has stopped.

    This is a convenience and no safety function: where people can be hurt, use the hardware's
    emergency stop.

    \b
    labos estop pf400
    labos estop rpl
    labos estop --all
    """
    from labos.cli._out import show_json

    if (target is None) is not everything:
        raise click.UsageError("Name one module or workcell, or say --all.")
    report = _stop(target or "*", connect, who(user), home)
    stopped, silent = sorted(report["stopped"]), report["silent"]
    if as_json:
        show_json(report)
    else:
        for module in stopped:
            click.echo(f"{module} is stopped.")
        for module, why in sorted(silent.items()):
            click.echo(f"{module} is NOT known to be stopped: {why.rstrip('.')}. Stop it by hand.", err=True)
    if silent or not stopped:
        if not silent:
            click.echo("No node lives that could be stopped.", err=True)
        raise click.exceptions.Exit(1)


def _stop(target: str, connect: Sequence[str], by: str, home: str | None) -> dict[str, Any]:
    """Through the kernel, else past it. Raises NotFound, BusError."""
    from labos.client import LabClient, LabUnreachable
    from labos.errors import NotFound
    from labos.settings import Settings, find_kernel, last_kernel

    folder = Settings.of(home).home
    last = last_kernel(folder)
    if not connect and find_kernel(folder) is not None:
        try:
            with LabClient(home=folder, patience_s=PATIENCE_S) as client:
                return client.emergency_stop(target, by)
        except LabUnreachable as error:
            click.echo(f"labos: {error.message} The nodes are told without it.", err=True)
    if not connect and last is None:
        raise NotFound(f"No lab has run in {folder}.", remedy="Name its --home, or the bus with --connect.")
    if connect or last is None:
        return _past_the_kernel(connect, target, by)
    return _past_the_kernel((last.bus,), target, by, last.lab)


def _past_the_kernel(connect: Sequence[str], target: str, by: str, lab: str = "*") -> dict[str, Any]:
    import msgspec

    from labos.bootstrap import stop_over_bus
    from labos.errors import BusError

    try:
        report = asyncio.run(stop_over_bus(connect, target, by, lab))
    except BusError as error:
        raise BusError(
            f"Nothing was stopped: {error.message}", remedy="Use the hardware's emergency stop."
        ) from error
    found: dict[str, Any] = msgspec.to_builtins(report)
    return found
