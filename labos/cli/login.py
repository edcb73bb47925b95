"""``labos login``, ``logout`` and ``whoami``: the user of all later commands."""

from __future__ import annotations

import os
from contextlib import suppress
from typing import TYPE_CHECKING

import click

from labos.cli._options import Asker, find_user, home_option, json_option, lab_and_json
from labos.cli._out import end_with_json, report_done
from labos.cli._people import ask_password
from labos.errors import NotFound, NotSignedIn
from labos.services.times import iso_time
from labos.settings import check_url

if TYPE_CHECKING:
    from labos.client import LabClient

HOW = {
    "token": "by a token",
    "session": "by a session",
    "home": "by the key in the lab's folder; it may read, stop modules, and help users to sign in",
    "open": "this lab has no users",
}


@click.command("login")
@click.argument("url", default="", metavar="[URL]")
@click.option("--user", metavar="NAME", default="", help="Sign in with the password of this user.")
@click.option(
    "--device",
    is_flag=True,
    help="For a computer without a browser: enter a code in a browser on another computer.",
)
@click.option(
    "--code",
    is_flag=True,
    help="As --device, for a provider that does not support it: copy an address from the browser.",
)
@click.option(
    "--port",
    type=click.IntRange(0, 65_535),
    default=0,
    help="The port to which the browser returns, if the provider requires a fixed one (default: any).",
)
@click.option(
    "--scope",
    type=click.Choice(["viewer", "submitter", "operator", "admin"]),
    default="admin",
    show_default=True,
    help="The highest role of the token; it never has more rights than you.",
)
@click.option(
    "--days",
    type=click.FloatRange(0.01, 366),
    default=30.0,
    show_default=True,
    help="The number of days for which it is valid.",
)
@home_option
@json_option
def login(
    url: str, user: str, device: bool, code: bool, port: int, scope: str, days: float, home: str | None
) -> None:
    """Sign in to the lab at URL (LABOS_URL, or the lab in the folder). Later commands then run as you.

    If the lab has an identity provider, a browser opens its sign-in page. The browser then returns to this
    command, which listens only on this computer. Without a provider, or with --user, the command asks for a
    password. Without a terminal, it reads the password from the first line of standard input.

    The lab issues a token. It is stored in ~/.config/labos/tokens.json, which only you can read.
    LABOS_TOKEN and LABOS_TOKEN_FILE take precedence over it. `labos token list` shows the token, `labos
    logout` revokes it.

    \b
    labos login https://lab7.example.org
    labos login https://lab7.example.org --device      on a computer without a browser
    labos login --user ada
    """
    import socket

    from labos.cli._provider import Way, sign_in
    from labos.client._token import keep_token

    if device and code:
        raise click.UsageError("Give either --device or --code.")
    if user and (device or code):
        raise click.UsageError("--device and --code cannot be combined with --user.")
    label = f"labos login on {socket.gethostname()}"
    with _find_lab(url, home) as client:
        place = client.token_place
        try:
            if user:
                raise NotFound("A password is needed.")
            way: Way = "device" if device else "code" if code else "browser"
            found = sign_in(client, way, port, label=label, scope=scope, days=days)
        except NotFound:
            if device or code:
                raise
            name = find_user(user or os.environ.get("LABOS_USER"))
            password = ask_password(f"Password of {name}")
            found = client.sign_in(name, password, label=label, scope=scope, days=days)
        keep_token(place, found["token"])
    until = iso_time(found["until"])[:16]
    facts = {"user": found["user"], "place": place, "until": found["until"], "scope": scope}
    report_done(f"You are signed in as {found['user']} at {place}, until {until}.", facts)


@click.command("logout")
@click.argument("url", default="", metavar="[URL]")
@home_option
@json_option
def logout(url: str, home: str | None) -> None:
    """Sign out of the lab at URL (LABOS_URL, or the lab in the folder). The token is revoked and deleted."""
    from labos.client._token import find_kept_token, keep_token

    with _find_lab(url, home) as client:
        place = client.token_place
        if not (kept := find_kept_token(place)):
            report_done(f"You have not signed in to {place}.", {"place": place, "signed_out": False})
            return
    with suppress(NotSignedIn), _find_lab(url, home, kept) as client:  # also if LABOS_TOKEN is set
        client.sign_out()  # else the token was not valid any more
    keep_token(place, "")
    report_done(f"You are signed out of {place}.", {"place": place, "signed_out": True})


def _find_lab(url: str, home: str | None, token: str = "") -> LabClient:
    """The lab at an address, or the one that other commands would use. Raises BadInput for an invalid
    address."""
    from labos.cli._lab import need_lab
    from labos.client import LabClient

    if not url:
        return need_lab(home, token)
    if home:
        raise click.UsageError("Name the lab by its URL or by --home.")
    return LabClient(check_url(url, "Your input"), token=token)


@click.command("whoami")
@lab_and_json
def whoami(asker: Asker) -> None:
    """Show the name of the signed-in user, and your rights in the lab."""
    with asker.lab() as client:
        found = client.identity()
    end_with_json(found)
    if found["how"] == "open":
        click.echo(f"{find_user(None)} (by your login: {HOW['open']}, and every user has all rights)")
        return
    until = f", until {iso_time(found['until'])[:16]}" if found["until"] else ""
    name = f" ({found['name']})" if found["name"] else ""
    click.echo(f"{found['user'] or 'Nobody'}{name}, {HOW[found['how']]}{until}")
    if found["group"]:
        click.echo(f"  group {found['group']}")
    for scope, role in found["roles"].items():
        click.echo(f"  {role} of {'the whole lab' if scope == '*' else scope}")
    if found["how"] == "token" and found["scope"] != "admin":
        click.echo(f"  the token has the rights of a {found['scope']} at most")
