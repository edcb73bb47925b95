"""``labos up``: runs a lab in the foreground."""

from __future__ import annotations

import threading
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from labos.cli._complete import make_completer
from labos.cli._options import (
    address_option,
    database_option,
    folder_home_option,
    folder_option,
    pki_option,
    speed_option,
    web_options,
)
from labos.errors import LabosError
from labos.settings import Settings, keep_private, was_simulated
from labos.telemetry.logs import configure_logs

if TYPE_CHECKING:
    from labos.bootstrap import LabThread


NO_USERS = (
    "labos: this lab has no users. Every user of this computer has all rights in it, under the login name. "
    "Add the first user with `labos user add NAME`."
)


@click.command("up")
@click.argument(
    "workcells", shell_complete=make_completer("workcell file"), nargs=-1, metavar="[WORKCELL]..."
)
@click.option(
    "--simulate/--real",
    default=None,
    help="Use a simulated bench or the real one. Required for a new lab; an existing lab keeps its setting.",
)
@speed_option
@folder_home_option
@database_option
@click.option("--http-port", type=int, help="The port of the HTTP interface (a free port if not given).")
@click.option(
    "--bus-port", type=int, help="The port of the bus that nodes connect to (a free port if not given)."
)
@click.option(
    "--host", default="127.0.0.1", show_default=True, help="The address on which HTTP and the bus listen."
)
@click.option(
    "--open-to-network",
    is_flag=True,
    help="Allow a bus without certificates on a --host that other computers reach: everybody who "
    "reaches it can act as a node.",
)
@web_options("the lab")
@click.option(
    "--first-user", default="", metavar="ID", help="Add this user as the admin, if the lab has no users."
)
@click.option(
    "--first-password",
    type=click.Path(dir_okay=False),
    default="",
    help="A file with the password of --first-user; used only if that user has none.",
)
@click.option(
    "--bus",
    multiple=True,
    metavar="ENDPOINT",
    help="A bus that runs in a separate process (`labos bus`), such as tcp/HOST:7447.",
)
@click.option(
    "--secure/--no-secure",
    default=None,
    help="TLS and certificates on the bus, which are made if there are none (default: as at the last start).",
)
@folder_option(
    "--cert", help="The kernel's own certificate, if the lab's certificate authority is elsewhere."
)
@address_option
@pki_option
@click.option(
    "--standby", is_flag=True, help="Follow the lab's log, and take over when its kernel dies or freezes."
)
@click.option(
    "--or-standby",
    is_flag=True,
    help="As --standby if another kernel runs the lab; otherwise run the lab.",
)
@click.option("--no-nodes", is_flag=True, help="Do not start nodes: they are started elsewhere.")
@click.option("--detach-nodes", is_flag=True, help="Nodes continue to run if this process is killed.")
@click.option(
    "--declare/--no-declare",
    default=None,
    help="Take the first labware on the bench from `stock:` of the file, or leave all stations unknown until "
    "they are declared (default: `stock:` on a simulated bench, unknown on a real one).",
)
@click.option(
    "--on-database-loss",
    metavar="stop|wait|SECONDS",
    default="",
    help="If the log cannot be written: stop at once, or wait for the database (30 s).",
)
@click.option(
    "--database-silence",
    type=click.FloatRange(min=1.0),
    metavar="SECONDS",
    help="After this time without an answer, the database counts as lost (10 s).",
)
@click.option(
    "--quarantine",
    metavar="TIMES/SECONDS|never",
    default="",
    help="Take a module out of service after this number of failures in this time, in lab seconds (5/600).",
)
@click.option("--seed", type=int, default=0, help="The seed of the simulated instruments' random durations.")
@click.option(
    "--wire", is_flag=True, help="Use the real drivers for simulated instruments, over simulated wires."
)
@click.option(
    "--trace",
    "trace_wires",
    is_flag=True,
    help="Write every byte on the devices' wires to HOME/traces, one file for each module.",
)
@click.option(
    "--node-metrics",
    is_flag=True,
    help="Nodes serve their own metrics, on free ports: Prometheus finds them at /metrics/targets.",
)
@click.option(
    "--otlp",
    metavar="URL",
    default="",
    help="Send traces of runs to this OpenTelemetry receiver, http://HOST:4318 (LABOS_OTLP).",
)
@click.option("--quiet", is_flag=True, help="Print no events.")
def command(
    workcells: tuple[str, ...],
    simulate: bool | None,
    home: str | None,
    database: str | None,
    secure: bool | None,
    cert: Path | None,
    address: tuple[str, ...],
    pki: Path | None,
    standby: bool,
    or_standby: bool,
    no_nodes: bool,
    detach_nodes: bool,
    declare: bool | None,
    quiet: bool,
    **as_set: Any,
) -> None:
    """Run a lab until Ctrl-C, with a node for each module. WORKCELL is a file or a packaged one.

    After Ctrl-C, the lab waits up to 30 s for actions in progress, then closes. A second Ctrl-C ends the
    wait. If an action has not finished by then, a simulated instrument is interrupted; a real instrument
    continues, and only its node ends. The next start finds out how the action ended. It asks a person if
    neither node nor sensor knows. The actions concerned are listed at the end.

    If you start the lab again in the same home, it continues where it was. No WORKCELL is needed then.

    \b
    labos up rpl --simulate --speed 60
    labos up workcell.yaml --real --home /var/lib/labos
    labos up rpl --simulate --secure            (docs/secure-bus.md)
    labos up rpl --real --host lab7 --tls-cert lab7.pem --tls-key lab7.key     (docs/security.md)
    labos up --standby --bus tcp/127.0.0.1:7447 --detach-nodes     (PostgreSQL; docs/standby.md)
    """
    from labos.bootstrap import LabThread
    from labos.cli._lab import end_in_order, read_workcell

    configure_logs("warning")
    keep_private()
    settings = Settings.make(
        home,
        database,
        simulate=simulate,
        secure=True if cert is not None else secure,
        certificate=cert.absolute() if cert is not None else None,
        addresses=address,
        authority=pki,
        **as_set,
    )
    if or_standby and _has_other_kernel(settings):
        standby, workcells = True, ()
    if standby:
        _check_standby(settings, workcells, no_nodes)
    if simulate is None and was_simulated(settings) is None:
        raise click.UsageError("This lab is new: give --simulate, or --real to move real instruments.")
    if not workcells and not standby and not (settings.home / "kernel.json").exists():
        raise click.UsageError("This lab is new: give its WORKCELL, for instance `labos up rpl --simulate`.")
    cells = [read_workcell(name) for name in workcells]
    lab = LabThread(
        settings,
        cells,
        nodes="none" if no_nodes else "processes",
        detach=detach_nodes,
        declare=declare,
        standby=(lambda: _stand_by(settings)) if standby else None,
    )
    with end_in_order(lab.hurry):
        try:
            with lab:
                if standby:
                    click.echo(f"The kernel {lab.replaced} has ended: this one has taken over.")
                _serve(lab, settings, quiet)
        except KeyboardInterrupt:
            pass
    for action in lab.cut_short:
        click.echo(f"{action} was interrupted: the next start finds out how it ended, or asks a person.")
    if lab.failure is not None:
        raise lab.failure
    if lab.left_to_standby:
        click.echo("The lab was handed over to a standby.")
    elif standby and not lab.replaced:
        click.echo("The standby has ended.")
    else:
        click.echo("The lab is closed. Its log is intact.")


def _stand_by(settings: Settings) -> None:
    from labos.store import show_url

    click.echo(f"Standing by for the lab in {show_url(settings.database)}. Ctrl-C ends it.")


def _has_other_kernel(settings: Settings) -> bool:
    """Whether another kernel runs the lab, according to its database. Raises StoreUnavailable."""
    from labos.store import find_database_file, open_store, read_database_status

    if find_database_file(settings.database) is not None:
        raise click.UsageError("--or-standby needs a lab on PostgreSQL (docs/standby.md).")
    if read_database_status(settings.database).state == "empty":
        return False
    with closing(open_store(settings.database, create=False, read_only=True)) as store:
        return store.find_holder().living


def _check_standby(settings: Settings, workcells: tuple[str, ...], no_nodes: bool) -> None:
    """A standby must not change the lab, and starts no nodes beside the running ones. Raises UsageError."""
    if workcells:
        raise click.UsageError("A standby runs the existing workcells of the lab: give no WORKCELL.")
    if not no_nodes and not (settings.home / "kernel.json").exists():
        raise click.UsageError(
            f"No kernel of this lab has run in {settings.home}, so its nodes were started elsewhere: "
            "give --no-nodes, or the --home of the lab."
        )


def _serve(lab: LabThread, settings: Settings, quiet: bool) -> None:
    """Show the lab's addresses, then its events, until a user ends it or it fails."""
    from labos.cli._lab import CLOSING

    runtime = lab.runtime
    kind = "simulated" if runtime.simulated else "real"
    click.echo(f"The lab {runtime.kernel.lab} runs ({kind}, speed {runtime.kernel.state.lab.pace:g}).")
    click.echo(f"  home  {settings.home}\n  http  {lab.url}\n  bus   {runtime.bus_endpoint}")
    if runtime.kernel.state.users.is_open:
        click.echo(NO_USERS, err=True)
    click.echo("Ctrl-C closes it.")
    if not quiet:
        threading.Thread(target=_narrate, args=(lab,), name="narrator", daemon=True).start()
    _listen_for_take_over(lab)
    try:
        while not lab.failed.wait(0.5):
            pass
    except KeyboardInterrupt:
        click.echo(f"\n{CLOSING}")


def _listen_for_take_over(lab: LabThread) -> None:
    """Leave the lab to a standby when `labos take-over` requests it."""
    import signal

    number = getattr(signal, "SIGUSR1", None)
    if number is not None and threading.current_thread() is threading.main_thread():
        signal.signal(number, lambda *_: lab.leave_to_standby())


def _narrate(lab: LabThread) -> None:
    from labos.cli._narrate import Narrator
    from labos.client import LabClient

    try:
        with LabClient(home=lab.settings.home, patience_s=10.0) as client:
            after = lab.runtime.nodes_from or client.health()["position"]
            Narrator(client, after).follow(lab.failed)
    except LabosError:
        return  # the lab has closed
