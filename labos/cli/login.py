"""``labos login``, ``logout`` and ``whoami``: who asks, from now on."""

from __future__ import annotations

import click

from labos.cli._options import home_option, json_option, user_option, who
from labos.cli._out import show_json, tell

HOW = {
    "token": "by a token",
    "session": "by a session",
    "home": "by the key in the lab's folder, which is good for looking, stopping modules, and helping others "
    "to sign in",
    "open": "this lab has no users",
}


@click.command("login")
@user_option
@click.option(
    "--days", type=click.FloatRange(0.01, 366), default=30.0, show_default=True, help="How long it is good."
)
@home_option
@json_option
def login(user: str | None, days: float, home: str | None, as_json: bool) -> None:
    """Sign in to the lab, with a password; from then on commands are yours.

    The lab gives a token, which is kept in ~/.config/labos/tokens.json, readable by you only. LABOS_TOKEN
    and LABOS_TOKEN_FILE go before it. Without a terminal, the first line of standard input is the password.

    \b
    labos login --user ada
    LABOS_URL=https://lab7.example.org labos login --user ada
    """
    import socket

    from labos.cli._lab import need_lab
    from labos.cli._secret import ask_password
    from labos.client._token import keep_token

    name = who(user)
    with need_lab(home) as client:
        place = client.token_place
        password = ask_password(f"Password of {name}")
        found = client.sign_in(name, password, label=f"labos login on {socket.gethostname()}", days=days)
        keep_token(place, found["token"])
    facts = {"user": found["user"], "place": place, "days": days}
    tell(f"You are {found['user']} at {place}, for {days:g} days.", facts, as_json=as_json)


@click.command("logout")
@home_option
@json_option
def logout(home: str | None, as_json: bool) -> None:
    """Sign out: the token is good no more, and is forgotten."""
    from labos.cli._lab import need_lab
    from labos.client._token import find_kept_token, keep_token
    from labos.errors import NotSignedIn

    with need_lab(home) as client:
        place = client.token_place
        if not find_kept_token(place):
            tell(
                f"You have not signed in to {place}.", {"place": place, "signed_out": False}, as_json=as_json
            )
            return
        try:
            client.sign_out()
        except NotSignedIn:
            pass  # it was good no more
        keep_token(place, "")
    tell(f"You are signed out of {place}.", {"place": place, "signed_out": True}, as_json=as_json)


@click.command("whoami")
@home_option
@json_option
def whoami(home: str | None, as_json: bool) -> None:
    """Who you are to the lab, and what you may do there."""
    from labos.cli._lab import need_lab
    from labos.services.times import iso_time

    with need_lab(home) as client:
        found = client.identity()
    if as_json:
        show_json(found)
        return
    if found["how"] == "open":
        click.echo(f"{who(None)} (by your login: {HOW['open']}, and everybody may do everything)")
        return
    until = f", until {iso_time(found['until'])[:16]}" if found["until"] else ""
    name = f" ({found['name']})" if found["name"] else ""
    click.echo(f"{found['user'] or 'Nobody'}{name}, {HOW[found['how']]}{until}")
    if found["group"]:
        click.echo(f"  group {found['group']}")
    for scope, role in found["roles"].items():
        click.echo(f"  {role} of {'the whole lab' if scope == '*' else scope}")
    if found["how"] == "token" and found["scope"] != "admin":
        click.echo(f"  the token is good for what a {found['scope']} may do")
