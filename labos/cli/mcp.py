"""``labos mcp``: a server with which an agent reads, plans and proposes."""

from __future__ import annotations

from typing import Any

import click

from labos.cli._options import home_option
from labos.cli._remote import is_given, lab_of
from labos.errors import BadInput

FOR_HTTP = {
    "host": "--host",
    "names": "--name",
    "certificate": "--tls-cert",
    "behind_proxy": "--behind-proxy",
}


@click.command("mcp", short_help="Let an agent read the lab, plan and propose work.")
@click.option("--behalf", default="", metavar="USER", help="Propose on behalf of this user.")
@click.option("--http-port", type=click.IntRange(0, 65_535), help="Serve HTTP on this port.")
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    metavar="ADDRESS",
    help="The address on which HTTP listens.",
)
@click.option(
    "--name",
    "names",
    multiple=True,
    metavar="HOST",
    help="A further name under which agents reach the server.",
)
@click.option(
    "--tls-cert", "certificate", default="", metavar="FILE", help="A certificate, for HTTP over TLS."
)
@click.option("--tls-key", "key", default="", metavar="FILE", help="Its private key.")
@click.option("--behind-proxy", is_flag=True, help="Another program provides TLS for this server.")
@home_option
def command(behalf: str, http_port: int | None, home: str | None, **served: Any) -> None:
    """Run a server of the Model Context Protocol on standard input and output. The agent's program starts
    this server. The server signs in to the lab as a service account, with the token in LABOS_TOKEN.

    With --http-port, several agents can use the server over HTTP (at /mcp). Each agent sends its own token
    (Authorization: Bearer …), and acts as the service account of this token. The server itself has no
    rights then, and ignores LABOS_TOKEN. If --host is an address that other computers reach, TLS is needed.

    The agent can read the lab and its log, check workflows and campaigns, and propose them. Each proposal
    waits for an operator (labos approvals). The agent cannot start anything.

    \b
    labos user add helper --service --role submitter
    labos token create --for helper "the agent"
    LABOS_URL=https://lab:8710 LABOS_TOKEN=… labos mcp --behalf ada
    LABOS_URL=https://lab:8710 labos mcp --http-port 8711
    """
    from labos.cli._lab import end_in_order
    from labos.http.server import Listening
    from labos.mcp.server import make_server, sign_in

    try:
        import mcp  # noqa: F401
    except ImportError:
        raise BadInput(
            "The package of the Model Context Protocol is not installed.",
            remedy='Run: pip install "labos-sdl[mcp]"',
        ) from None
    if http_port is None:
        for name, option in FOR_HTTP.items():
            if is_given(name):
                raise click.UsageError(f"{option} goes with --http-port.")
        with sign_in(lab_of(home), home, behalf=behalf) as lab:
            make_server(lab).run("stdio")
        return
    if behalf:
        raise click.UsageError("Over HTTP each agent names its user (LabOS-On-Behalf-Of).")
    from labos.mcp.http import serve

    listening = Listening(port=http_port, **served)
    with end_in_order():
        serve(lab_of(home), home, listening, lambda url: click.echo(f"Agents reach the lab at {url}"))
