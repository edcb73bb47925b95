"""``labos node``: one module's node, LabOS' own or a foreign one."""

from __future__ import annotations

import asyncio
import sys
from typing import Any

import click

from labos.cli._options import home_option


@click.group("node")
def command() -> None:
    """Start the node of a module: the process that answers for one instrument."""


@command.command("start")
@click.argument("driver", default="")
@click.option("--name", required=True, help="The module's name in the workcell.")
@click.option("--workcell", required=True, help="The workcell's name.")
@click.option("--simulate", is_flag=True, help="Drive a simulated device on the lab's simulated bench.")
@click.option("--wire", is_flag=True, help="With --simulate: reach the simulated device over its wire.")
@click.option("--trace", default="", metavar="FILE", help="Write every byte on the device's wire to a file.")
@click.option("--connect", multiple=True, metavar="ENDPOINT", help="The lab's bus, as tcp/192.168.1.5:7447.")
@home_option
@click.option(
    "--with-parent", is_flag=True, help="End when standard input ends, as it does when the parent dies."
)
@click.option(
    "--finish-s",
    type=float,
    help="How long what runs may go on when the node is stopped (simulated: 30 s, real: to its end).",
)
def start(
    driver: str,
    name: str,
    workcell: str,
    simulate: bool,
    wire: bool,
    trace: str,
    connect: tuple[str, ...],
    home: str | None,
    with_parent: bool,
    finish_s: float | None,
) -> None:
    """Answer for a module until stopped. DRIVER is the one the workcell names if left out.

    The node waits for its lab, learns the module's settings from it, and goes on when the lab
    is restarted. Its journal is kept in HOME/journals.

    \b
    labos node start a4s_sealer --name sealer --workcell rpl --simulate
    labos node start --name sealer --workcell rpl --connect tcp/192.168.1.5:7447
    """
    if wire and not simulate:
        raise click.UsageError("--wire is for simulated devices: add --simulate.")

    from labos.bootstrap import run_node
    from labos.settings import Settings, keep_private
    from labos.telemetry.logs import configure_logs

    configure_logs("info")
    keep_private()
    settings = Settings.of(home)
    asyncio.run(
        run_node(
            driver,
            name,
            workcell,
            settings,
            connect=connect,
            simulate=simulate,
            wire=wire,
            trace=trace,
            with_parent=with_parent,
            finish_s=finish_s,
        )
    )


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
    help="What else stands below `config:` of the module, in YAML.",
)
def about(interface: str, address: str, auth: str, more: tuple[str, ...]) -> None:
    """Ask a foreign node what it offers, and print it as a module in a workcell file.

    INTERFACE is the adapter (wei_rest_node, madsci_rest_node, sila_node, tcp_node, wei_ros_node), ADDRESS
    the node's URL, its host:port, or its name in ROS. What the actions do to the bench the node does not
    know: fill in `effects`, `duration` and the stations.

    \b
    labos node about wei_rest_node http://barty.lab:8000
    labos node about tcp_node reader.lab:7001
    labos node about sila_node shaker.lab:50052 --config sila_certificate=/etc/labos/shaker.pem
    labos node about wei_ros_node /std_ns/arm --config ros_python=/opt/lab/ros_python --config ros_domain=7
    """
    from labos.adapter import describe_foreign
    from labos.spec.about import about_of
    from labos.spec.emit import to_yaml
    from labos.spec.interfaces import config_at

    config = config_at(interface, address)
    if auth:
        config["node_auth" if interface.startswith("madsci") else "rest_node_auth"] = auth
    config |= dict(map(_read_setting, more))
    described = asyncio.run(describe_foreign(interface, config))
    module = {"interface": interface, "config": config, "about": about_of(described)}
    click.echo(to_yaml(module), nl=False)


def _read_setting(written: str) -> tuple[str, Any]:
    """``key=value`` of a config. Raises BadInput."""
    import yaml

    from labos.errors import BadInput

    key, sign, value = written.partition("=")
    try:
        if not sign or not key:
            raise ValueError("there is no `=`")
        return key, yaml.safe_load(value)
    except (ValueError, yaml.YAMLError) as error:
        raise BadInput(f"--config {written!r} cannot be read: {error}.", remedy="Write KEY=VALUE.") from error
