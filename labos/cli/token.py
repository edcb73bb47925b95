"""``labos token``: tokens with which programs sign in."""

from __future__ import annotations

import click

from labos.cli._group import Suggesting
from labos.cli._options import Asker, lab_and_json
from labos.cli._out import end_with_json, report_done, show_table
from labos.services.times import iso_time


@click.group("token", cls=Suggesting)
def command() -> None:
    """Manage access tokens. A program signs in to the lab with a token."""


@command.command("create")
@click.argument("label", default="")
@click.option(
    "--scope",
    type=click.Choice(["viewer", "submitter", "operator", "admin"]),
    default="submitter",
    show_default=True,
    help="The highest role of the token; it never has more rights than its user.",
)
@click.option(
    "--days",
    type=click.FloatRange(0.001, 366),
    default=90.0,
    show_default=True,
    help="The number of days for which it is valid.",
)
@click.option(
    "--for",
    "user",
    metavar="USER",
    default="",
    help="The user of the token, such as a service account; for admins.",
)
@lab_and_json
def create(label: str, scope: str, days: float, user: str, asker: Asker) -> None:
    """Create a token for a program. LABEL describes its purpose. The token is shown only once, because the
    lab stores only its digest.

    Give the token to the program in the variable LABOS_TOKEN, or in a file that LABOS_TOKEN_FILE names.
    Only the file's owner may have the right to read it.

    \b
    labos token create "color picker"
    labos token create prometheus --scope viewer --days 366
    labos token create agent --for planner
    """
    with asker.lab() as client:
        made = client.make_token(label, scope=scope, days=days, user=user)
    end_with_json(made)
    token = made["token"]
    until = iso_time(token["expires_at"])[:16]
    click.echo(
        f"{token['id']}: of {token['user']}, with the role {scope} at most, valid until {until}. "
        "Store it now, it is not shown again:",
        err=True,
    )
    click.echo(made["secret"])


@command.command("list")
@click.option("--for", "user", metavar="USER", default="", help="List the tokens of this user; for admins.")
@lab_and_json
def list_(user: str, asker: Asker) -> None:
    """List your tokens, and when each was last used (to the minute)."""
    with asker.lab() as client:
        tokens = client.tokens(user)
    end_with_json(tokens)

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
@lab_and_json
def revoke(token: str, asker: Asker) -> None:
    """Revoke a token. ID is the one that `labos token list` shows. The token is invalid from now on."""
    with asker.lab() as client:
        client.revoke_token(token)
    report_done(f"The token {token} is revoked.", {"token": token, "revoked": True})
