"""``labos user``: who may use the lab."""

from __future__ import annotations

from typing import Any

import click

from labos.cli._group import Suggesting
from labos.cli._options import find_user, home_option, json_option, user_option
from labos.cli._out import show_json, show_table, tell
from labos.cli._people import in_words, lab_at, lab_or_its_folder, role_choice, scope_of, workcell_option
from labos.services.times import show_time

_id = click.argument("name", metavar="ID")


@click.group("user", cls=Suggesting, short_help="Users: who may use the lab.")
def command() -> None:
    """Who may use the lab.

    A lab without users is open: whoever reaches it may do everything. The first user who is added becomes its
    admin, and from then on nobody but users may do anything. A user may look; what else, roles say (labos
    role). An id is no name and no mail address: the log keeps it for ever.

    \b
    labos user add ada                       the first one: admin of the lab
    labos user add bo --role submitter       may submit, and touch what is theirs
    labos user password bo                   what bo signs in with (labos login)
    labos user add robot --service           a program or an agent
    labos user list
    labos user disable bo                    may do nothing any more
    """


@command.command("add")
@_id
@click.option("--service", is_flag=True, help="A program or an agent, which may act on behalf of users.")
@click.option("--role", type=role_choice, help="Grant this role too.")
@click.option("--name", "person", metavar="NAME", help="Who it is; kept beside the log, and can be erased.")
@click.option("--mail", metavar="ADDRESS", help="A mail address; as the name.")
@workcell_option
@user_option
@home_option
@json_option
def add(
    name: str,
    service: bool,
    role: str | None,
    person: str | None,
    mail: str | None,
    workcell: str | None,
    user: str | None,
    home: str | None,
    as_json: bool,
) -> None:
    """Let a person, or a program, use the lab."""
    if workcell and not role:
        raise click.UsageError("--workcell says where a --role counts.")
    with lab_or_its_folder(home) as client:
        by = find_user(user)
        is_first = not client.users()
        client.add_user(
            name, by, kind="service" if service else "person", role=role, scope=scope_of(workcell)
        )
        if person or mail:
            client.set_person(name, name=person, mail=mail)
        found = client.user(name)
    if as_json:
        show_json(found)
        return
    if is_first:
        click.echo(f"{name} is the admin of this lab. From now on nobody but its users may do anything.")
    else:
        what = "a service account" if service else "a user"
        click.echo(f"{name} is {what} of this lab: {in_words(found['roles']) or 'may look'}.")
    next_step = f"token create LABEL --for {name}" if service else f"user password {name}"
    click.echo(f"Next: labos {next_step}")


@command.command("list")
@home_option
@json_option
def list_users(home: str | None, as_json: bool) -> None:
    """All users, with their groups and roles."""
    with lab_at(home) as client:
        found = client.users()
    if as_json:
        show_json(found)
        return
    show_table(("id", "kind", "group", "roles", "since"), [_row(user) for user in found])
    if not found:
        click.echo("There are no users: whoever reaches this lab may do everything.", err=True)


@command.command("show")
@_id
@home_option
@json_option
def show(name: str, home: str | None, as_json: bool) -> None:
    """One user, with the roles that come from the user's group."""
    with lab_at(home) as client:
        found = client.user(name)
        groups = {group["name"]: group for group in client.groups()}
    found["group_roles"] = groups.get(found["group"], {}).get("roles", {})
    if as_json:
        show_json(found)
        return
    lines = (
        ("id", name),
        ("kind", found["kind"] + (", disabled" if found["disabled"] else "")),
        ("since", show_time(found["since"])),
        ("roles", in_words(found["roles"])),
        ("group", found["group"]),
        ("roles of the group", in_words(found["group_roles"])),
    )
    for title, text in lines:
        click.echo(f"{title + ':':20}{text or 'none'}")


@command.command("disable")
@_id
@user_option
@home_option
@json_option
def disable(name: str, user: str | None, home: str | None, as_json: bool) -> None:
    """Let a user do nothing any more. Runs under way and runs that wait go on, campaigns are paused. Users
    are never removed, because the log speaks of them."""
    with lab_at(home) as client:
        client.disable_user(name, find_user(user))
        found = client.user(name) if as_json else {}
    if as_json:
        show_json(found)


@command.command("enable")
@_id
@user_option
@home_option
@json_option
def enable(name: str, user: str | None, home: str | None, as_json: bool) -> None:
    """Let a user who was disabled act again."""
    with lab_at(home) as client:
        client.enable_user(name, find_user(user))
        found = client.user(name) if as_json else {}
    if as_json:
        show_json(found)


@command.command("password")
@_id
@home_option
@json_option
def password(name: str, home: str | None, as_json: bool) -> None:
    """Change a password: your own, by the present one; as an admin, or on the lab's computer as the owner of
    its folder, anybody's.

    It is typed on a terminal; without one, the first line of standard input is the new one (before it, for
    your own, the present one). All sessions of the user end.
    """
    from labos.cli._secret import ask_password

    with lab_or_its_folder(home) as client:
        present = ask_password("Your present password") if client.identity()["user"] == name else ""
        client.set_password(name, ask_password(f"New password of {name}", twice=True), present)
    tell(f"{name} has a new password.", {"user": name, "password_set": True}, as_json=as_json)


@command.command("name")
@_id
@click.option("--name", "person", metavar="NAME", help="Who it is.")
@click.option("--mail", metavar="ADDRESS", help="A mail address.")
@home_option
@json_option
def rename(name: str, person: str | None, mail: str | None, home: str | None, as_json: bool) -> None:
    """Say who a user is. Names and addresses are kept beside the log, which knows ids alone."""
    with lab_or_its_folder(home) as client:
        client.set_person(name, name=person, mail=mail)
    tell(f"It is known who {name} is.", {"user": name, "name": person, "mail": mail}, as_json=as_json)


@command.command("erase")
@_id
@home_option
@json_option
def erase(name: str, home: str | None, as_json: bool) -> None:
    """Forget who a user is: name, address, password, tokens, sessions. Events remain, and bear the id.

    The user is still one: `labos user disable` besides lets nobody act under the id.
    """
    with lab_or_its_folder(home) as client:
        client.erase_person(name)
    tell(f"Nothing is known of {name} any more but the id.", {"user": name, "erased": True}, as_json=as_json)


@command.command("link")
@_id
@click.argument("issuer")
@click.argument("subject")
@home_option
@json_option
def link(name: str, issuer: str, subject: str, home: str | None, as_json: bool) -> None:
    """Say whom an identity provider means by a user: SUBJECT is what the provider ISSUER, a URL, calls them.

    \b
    labos user link ada https://login.example.org 248289761001
    """
    with lab_or_its_folder(home) as client:
        client.link_identity(name, issuer, subject)
    tell(
        f"{subject} of {issuer} is {name} here.",
        {"user": name, "issuer": issuer, "subject": subject},
        as_json=as_json,
    )


def _row(user: dict[str, Any]) -> tuple[str, ...]:
    kind = user["kind"] + (", disabled" if user["disabled"] else "")
    return user["id"], kind, user["group"], in_words(user["roles"]), show_time(user["since"])
