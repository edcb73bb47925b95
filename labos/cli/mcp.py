"""``labos mcp``: a server through which an agent looks, plans and proposes."""

from __future__ import annotations

import click

from labos.cli._options import home_option


@click.command("mcp", short_help="Let an agent look, plan and propose.")
@click.option("--behalf", default="", metavar="USER", help="Propose on behalf of this user.")
@click.option("--http-port", type=click.IntRange(0, 65_535), help="Speak HTTP on this port.")
@click.option("--host", default="127.0.0.1", show_default=True, metavar="ADDRESS", help="Where HTTP listens.")
@click.option(
    "--name", "names", multiple=True, metavar="HOST", help="A further name under which agents reach it."
)
@click.option("--tls-cert", default="", metavar="FILE", help="A certificate, for HTTP over TLS.")
@click.option("--tls-key", default="", metavar="FILE", help="Its private key.")
@click.option("--behind-proxy", is_flag=True, help="Another program speaks TLS for it.")
@home_option
def command(
    behalf: str,
    http_port: int | None,
    host: str,
    names: tuple[str, ...],
    tls_cert: str,
    tls_key: str,
    behind_proxy: bool,
    home: str | None,
) -> None:
    """A server of the Model Context Protocol, spoken to over standard input and output: an agent's program
    starts it. It signs in as a service account, with the token in LABOS_TOKEN.

    With --http-port it is spoken to over HTTP (at /mcp) by several agents. Each shows a token of its own
    (Authorization: Bearer …), and acts as the service account whose it is; the server itself has no rights,
    and does not look at LABOS_TOKEN. --host with an address that others reach takes TLS.

    The agent can look at the lab and its log, check workflows and campaigns, and propose them. What it
    proposes waits for an operator (labos approvals); there is nothing by which it could start anything.

    \b
    labos user add helper --service --role submitter
    labos token create --for helper "the agent"
    LABOS_URL=https://lab:8710 LABOS_TOKEN=… labos mcp --behalf ada
    LABOS_URL=https://lab:8710 labos mcp --http-port 8711
    """
    from labos.cli._lab import orderly
    from labos.cli._remote import is_given, lab_of
    from labos.errors import BadInput
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
        if given := [name for name in ("host", "names", "tls_cert", "behind_proxy") if is_given(name)]:
            raise click.UsageError(f"--{given[0].rstrip('s').replace('_', '-')} goes with --http-port.")
        with sign_in(lab_of(home), home, behalf=behalf) as lab:
            make_server(lab).run("stdio")
        return
    if behalf:
        raise click.UsageError("Over HTTP each agent says for whom it acts (LabOS-On-Behalf-Of).")
    from labos.mcp.http import serve

    listening = Listening(host, http_port, names, tls_cert, tls_key, behind_proxy)
    with orderly():
        serve(lab_of(home), home, listening, lambda url: click.echo(f"Agents reach the lab at {url}"))
