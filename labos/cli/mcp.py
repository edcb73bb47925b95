"""``labos mcp``: a server through which an agent looks, plans and proposes."""

from __future__ import annotations

import click

from labos.cli._options import home_option


@click.command("mcp", short_help="Let an agent look, plan and propose.")
@click.option("--behalf", default="", metavar="USER", help="Propose on behalf of this user.")
@home_option
def command(behalf: str, home: str | None) -> None:
    """A server of the Model Context Protocol, spoken to over standard input and output: an agent's program
    starts it. It signs in as a service account, with the token in LABOS_TOKEN.

    The agent can look at the lab and its log, check workflows and campaigns, and propose them. What it
    proposes waits for an operator (labos approvals); there is nothing by which it could start anything.

    \b
    labos user add helper --service --role submitter
    labos token create --for helper "the agent"
    LABOS_URL=https://lab:8710 LABOS_TOKEN=… labos mcp --behalf ada
    """
    from labos.cli._remote import lab_of
    from labos.errors import BadInput
    from labos.mcp.server import make_server, sign_in

    try:
        import mcp  # noqa: F401
    except ImportError:
        raise BadInput(
            "The package of the Model Context Protocol is not installed.",
            remedy='Run: pip install "labos-sdl[mcp]"',
        ) from None
    with sign_in(lab_of(home), home, behalf=behalf) as lab:
        make_server(lab).run("stdio")
