"""``labos token``: tokens, by which programs are known to the lab."""

from __future__ import annotations

import click

from labos.cli._group import Suggesting
from labos.cli._options import home_option, json_option
from labos.cli._out import show_json, tell


@click.group("token", cls=Suggesting)
def command() -> None:
    """Tokens, by which programs are known to the lab."""


@command.command("create")
@click.argument("label", default="")
@click.option(
    "--scope",
    type=click.Choice(["viewer", "submitter", "operator", "admin"]),
    default="submitter",
    show_default=True,
    help="The most that it is good for; what its user may not do, it may not do either.",
)
@click.option(
    "--days", type=click.FloatRange(0.001, 366), default=90.0, show_default=True, help="How long it is good."
)
@click.option(
    "--for", "user", metavar="USER", default="", help="Whose it is, such as a service account; for admins."
)
@home_option
@json_option
def create(label: str, scope: str, days: float, user: str, home: str | None, as_json: bool) -> None:
    """Make a token for a program; LABEL says what it is for. It is shown once: the lab keeps its digest.

    The program shows it by the variable LABOS_TOKEN, or by LABOS_TOKEN_FILE, a file that its owner alone
    can read.

    \b
    labos token create "color picker"
    labos token create prometheus --scope viewer --days 366
    labos token create agent --for planner
    """
    from labos.cli._lab import need_lab
    from labos.services.times import iso_time

    with need_lab(home) as client:
        made = client.make_token(label, scope=scope, days=days, user=user)
    if as_json:
        show_json(made)
        return
    token = made["token"]
    until = iso_time(token["expires_at"])[:16]
    click.echo(
        f"{token['id']}: of {token['user']}, good for what a {scope} may do, until {until}. Keep it:",
        err=True,
    )
    click.echo(made["secret"])


@command.command("list")
@click.option("--for", "user", metavar="USER", default="", help="Whose, if not yours; for admins.")
@home_option
@json_option
def list_(user: str, home: str | None, as_json: bool) -> None:
    """Your tokens, with when they were last used (to the minute)."""
    from labos.cli._lab import need_lab
    from labos.cli._out import show_table
    from labos.services.times import iso_time

    with need_lab(home) as client:
        tokens = client.tokens(user)
    if as_json:
        show_json(tokens)
        return

    def when(time: int) -> str:
        return iso_time(time)[:16] if time else ""

    show_table(
        ("id", "user", "label", "scope", "until", "last used", "revoked"),
        [
            (
                *(token["id"], token["user"], token["label"], token["scope"]),
                *(when(token["expires_at"]), when(token["used_at"]), when(token["revoked_at"])),
            )
            for token in tokens
        ],
    )


@command.command("revoke")
@click.argument("token", metavar="ID")
@home_option
@json_option
def revoke(token: str, home: str | None, as_json: bool) -> None:
    """Revoke a token; ID is what `labos token list` shows. It is good for nothing from now on."""
    from labos.cli._lab import need_lab

    with need_lab(home) as client:
        client.revoke_token(token)
    tell(f"The token {token} is revoked.", {"token": token, "revoked": True}, as_json=as_json)
