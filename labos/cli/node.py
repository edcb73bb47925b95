"""``labos node``: the node of one module, LabOS' own or a foreign one."""

from __future__ import annotations

import asyncio
import os
import sys
from pathlib import Path
from typing import Any, NamedTuple

import click

from labos.cli._complete import make_completer
from labos.cli._group import Suggesting
from labos.cli._node_install import install
from labos.cli._options import (
    Asker,
    asker_options,
    cert_option,
    folder_home_option,
    json_option,
    user_option,
    why_option,
)
from labos.cli._out import end_with_json, report_done
from labos.clock import SystemClock, Uuid7Ids
from labos.errors import BadInput, NotFound
from labos.settings import HOME, Settings, keep_private
from labos.telemetry.logs import configure_logs


@click.group("node", cls=Suggesting)
def command() -> None:
    """Start and manage nodes. A node is the process that controls one instrument."""


@command.command("start")
@click.argument("driver", default="")
@click.option("--name", required=True, help="The module's name in the workcell.")
@click.option("--workcell", required=True, help="The workcell's name.")
@click.option("--simulate", is_flag=True, help="Use a simulated device on the lab's simulated bench.")
@click.option("--wire", is_flag=True, help="With --simulate: use the real driver, over a simulated wire.")
@click.option("--trace", default="", metavar="FILE", help="Write every byte on the device's wire to a file.")
@click.option(
    "--metrics-port",
    type=click.IntRange(0, 65535),
    metavar="PORT",
    help="Serve the node's metrics for Prometheus on this port; 0: a free port, reported to the lab.",
)
@click.option(
    "--metrics-host",
    default="127.0.0.1",
    show_default=True,
    help="The address of --metrics-port; with 0.0.0.0, other computers can read the metrics.",
)
@click.option(
    "--connect", multiple=True, metavar="ENDPOINT", help="The lab's bus, such as tcp/192.168.1.5:7447."
)
@click.option("--secure", is_flag=True, help="Connect only to a secure bus (tls/HOST:PORT).")
@cert_option
@folder_home_option
@click.option(
    "--with-parent",
    is_flag=True,
    help="End when standard input ends, for instance because the parent process has ended.",
)
@click.option(
    "--finish-s",
    type=float,
    help="How many seconds an action may continue after a stop (simulated: 30, real: to its end).",
)
def start(
    driver: str,
    name: str,
    workcell: str,
    simulate: bool,
    wire: bool,
    metrics_port: int | None,
    metrics_host: str,
    secure: bool,
    cert: Path | None,
    home: str | None,
    **more: Any,
) -> None:
    """Run the node of a module until it is stopped. DRIVER defaults to the driver in the workcell file.

    The node waits for its lab, gets the module's settings from it, and continues after a restart of the
    lab. Its journal is in HOME/journals. Give the same --home at every start: without its journal the node
    does not know what it did before.

    \b
    labos node start a4s_sealer --name sealer --workcell rpl --simulate
    labos node start --name sealer --workcell rpl --connect tcp/192.168.1.5:7447 --home /var/lib/labos
    labos node start --name sealer --workcell rpl --connect tls/lab.example.org:7447 --cert rpl.sealer
    """
    if wire and not simulate:
        raise click.UsageError("--wire is for simulated devices: add --simulate.")

    from labos.bootstrap import run_node

    configure_logs("info")
    keep_private()
    settings = Settings.make(home)
    if not simulate:
        _expect_home(settings, home)
    asyncio.run(
        run_node(
            driver,
            name,
            workcell,
            settings,
            certificate=cert.absolute() if cert is not None else None,
            secure=secure or cert is not None,
            simulate=simulate,
            wire=wire,
            metrics=(metrics_host, metrics_port) if metrics_port is not None else None,
            **more,
        )
    )


def _expect_home(settings: Settings, named: str | None) -> None:
    """Raises BadInput if a new folder would be made only because the command was typed in another place: the
    journal of the module's last node would stay elsewhere, unread."""
    if not named and not os.environ.get(HOME) and not settings.home.is_dir():
        raise BadInput(
            f"{settings.home} is not the folder of a lab. Without its journal this node does not "
            "know what it did before.",
            remedy="Name the folder of the module's journal with --home DIR (a new folder is created). "
            "Use the same folder at every start.",
        )


@command.command("reset-epoch")
@click.argument("module")
@click.option("--epoch", type=int, help="The epoch of the lab's kernel, as `labos db status` shows it.")
@click.option("--position", type=int, help="The end of the lab's log, as `labos db status` shows it.")
@why_option("The reason, for the journal.", required=True)
@user_option
@folder_home_option
@json_option
def reset_epoch(
    module: str, epoch: int | None, position: int | None, why: str, user: str, home: str | None
) -> None:
    """Correct a wrong number in MODULE's journal: an epoch that no kernel of the lab ever had, or an
    acknowledged position that the lab's log never reached.

    With such a number, the node no longer accepts any kernel or any request. Stop the node first. Make sure
    that only one kernel of this lab runs, because the node accepts older kernels again. The record of the
    node's actions stays in its journal. User, time and reason of this correction are added. Run this
    command where the journal is (HOME/journals).

    \b
    labos node reset-epoch rpl/pf400 --epoch 7 --why "a test script sent epoch 2^62"
    labos node reset-epoch rpl/pf400 --position 1200 --why "acknowledged far too much"
    """
    from labos.node.limits import cut, cut_name

    if epoch is None and position is None:
        raise click.UsageError("Give the number to correct: --epoch, --position or both.")
    path = Settings.make(home).journal(module)
    if not path.exists():
        raise NotFound(f"There is no journal {path}.", remedy="Name WORKCELL/MODULE, and its --home.")
    was, now = asyncio.run(_correct(path, epoch, position, cut_name(user), cut(why)))
    facts = {"journal": str(path), "epoch": now.epoch, "position": now.position, "was": was._asdict()}
    report_done(f"{path}: {now} (it was {was}).", facts)


@command.command("trace")
@click.argument("module", shell_complete=make_completer("module"))
@click.option("--off", is_flag=True, help="Stop recording.")
@asker_options
def trace_command(module: str, off: bool, asker: Asker) -> None:
    """Record every byte on the wires of MODULE's device. The file is on the computer of its node.

    \b
    labos node trace sealer
    labos node trace sealer --off
    labos up … --trace               all modules, from their start
    """
    with asker.lab() as client:
        file = client.trace(module, asker.user, on=not off)
    message = f"{module}: {'written to' if not off else 'no longer written to'} {file}"
    report_done(message, {"module": module, "file": file, "on": not off})


@command.command("accept-unit")
@click.argument("module")
@click.argument("serial", required=False, default="")
@folder_home_option
@json_option
def accept_unit(module: str, serial: str, home: str | None) -> None:
    """Accept another unit as the device of MODULE: the unit with this SERIAL number, or without SERIAL the
    unit that is connected next.

    A node remembers the serial number of its first device and refuses all other units, because taught
    positions of one robot are wrong for another. Reset the module afterwards. If the workcell file has
    `serial:`, change it there too. Run this command where the node's journal is (HOME/journals).

    \b
    labos node accept-unit rpl/ot2_pcr_alpha OT2CEP20200309B04
    """
    from labos.node.unit import forget_unit, keep_unit, read_known_unit

    settings = Settings.make(home)
    journal, file = settings.journal(module), settings.unit(module)
    if not journal.exists():
        raise NotFound(f"There is no journal {journal}.", remedy="Name WORKCELL/MODULE, and its --home.")
    was = read_known_unit(file)
    if serial:
        keep_unit(file, serial)
    else:
        forget_unit(file)
    message = f"{module}: {serial or 'the next unit'} is accepted (it was {was or 'none'}). Reset the module."
    report_done(message, {"module": module, "serial": serial, "was": was})


command.add_command(install)


class JournalFacts(NamedTuple):
    """The lab's facts in a journal."""

    epoch: int
    position: int

    def __str__(self) -> str:
        return f"epoch {self.epoch}, acknowledged up to position {self.position}"


async def _correct(
    path: Path, epoch: int | None, position: int | None, by: str, why: str
) -> tuple[JournalFacts, JournalFacts]:
    """Correct a journal with a person's facts; returns its facts before and after. Raises JournalError (its
    node is running), JournalDamaged, BadInput."""
    from labos.node.journal import Journal
    from labos.node.journal_file import FileJournalFile

    clock = SystemClock()
    journal = await Journal.open(FileJournalFile(path), Uuid7Ids())
    try:
        was = JournalFacts(journal.memory.epoch, journal.memory.pruned)
        journal.correct(
            epoch=journal.memory.epoch if epoch is None else epoch,
            position=journal.memory.pruned if position is None else position,
            by=by,
            at_ns=clock.now_ns(),
            why=why,
        )
        await journal.sync()
        return was, JournalFacts(journal.memory.epoch, journal.memory.pruned)
    finally:
        await journal.close()


@command.command("fork-server", hidden=True)
@click.argument("link", type=int)
def fork_server(link: int) -> None:
    """Become the nodes that the kernel asks for over a socket, which is descriptor LINK."""
    import socket

    import labos.bus
    import labos.link
    import labos.telemetry.logs  # noqa: F401
    from labos.bootstrap import run_node  # noqa: F401
    from labos.cli.app import main
    from labos.runtime.fork_server import serve

    words = serve(socket.socket(fileno=link))
    if words is not None:
        sys.exit(main(list(words)))


@command.command("about")
@click.argument("interface")
@click.argument("address")
@click.option("--auth", default="", metavar="FILE", help="A file with the value of the Authorization header.")
@click.option(
    "--config",
    "more",
    multiple=True,
    metavar="KEY=VALUE",
    help="Further keys below `config:` of the module, in YAML.",
)
@json_option
def about(interface: str, address: str, auth: str, more: tuple[str, ...]) -> None:
    """Ask a foreign node for its actions, and print them as a module for a workcell file.

    INTERFACE is the adapter (wei_rest_node, madsci_rest_node, sila_node, tcp_node, wei_ros_node). ADDRESS
    is the node's URL, its host:port, or its name in ROS. The node does not know the effects of its actions
    on the bench: add `effects`, `duration` and the stations yourself.

    \b
    labos node about wei_rest_node http://barty.lab:8000
    labos node about tcp_node reader.lab:7001
    labos node about sila_node shaker.lab:50052 --config sila_certificate=/etc/labos/shaker.pem
    labos node about wei_ros_node /std_ns/arm --config ros_python=/opt/lab/ros_python --config ros_domain=7
    """
    from labos.adapter import describe_foreign
    from labos.spec.about import make_about
    from labos.spec.emit import to_yaml
    from labos.spec.interfaces import make_config_at

    config = make_config_at(interface, address)
    if auth:
        config["node_auth" if interface.startswith("madsci") else "rest_node_auth"] = auth
    config |= dict(map(_read_setting, more))
    described = asyncio.run(describe_foreign(interface, config))
    module = {"interface": interface, "config": config, "about": make_about(described)}
    end_with_json(module)
    click.echo(to_yaml(module), nl=False)


def _read_setting(written: str) -> tuple[str, Any]:
    """``key=value`` of a config. Raises BadInput."""
    import yaml

    key, sign, value = written.partition("=")
    try:
        if not sign or not key:
            raise ValueError("there is no `=`")
        return key, yaml.safe_load(value)
    except (ValueError, yaml.YAMLError) as error:
        raise BadInput(f"--config {written!r} cannot be read: {error}.", remedy="Write KEY=VALUE.") from error
