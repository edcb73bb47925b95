"""``labos user``: the users of the lab."""

from __future__ import annotations

from typing import Any

import click

from labos.cli._group import Suggesting
from labos.cli._options import Asker, asker_options, lab_and_json
from labos.cli._out import end_with_json, report_done, show_json, show_table, wants_json
from labos.cli._people import (
    ask_password,
    describe_roles,
    lab_or_its_folder,
    role_choice,
    scope_of,
    workcell_option,
)
from labos.services.times import show_time

_id = click.argument("name", metavar="ID")


@click.group("user", cls=Suggesting, short_help="Manage users.")
def command() -> None:
    """Manage users.

    A lab without users is open: everybody with network access to it has all rights. The first user becomes
    its admin. From then on only users have access. Every user may read. Roles grant further rights (labos
    role). Do not use a person's name or mail address as the id, because the log keeps ids forever.

    \b
    labos user add ada                       the first one: admin of the lab
    labos user add bo --role submitter       may submit, and change own runs and labware
    labos user password bo                   set bo's password for labos login
    labos user add robot --service           a program or an agent
    labos user list
    labos user disable bo                    withdraw all rights
    """


@command.command("add")
@_id
@click.option("--service", is_flag=True, help="A program or an agent, which may act on behalf of users.")
@click.option("--role", type=role_choice, help="Also grant this role.")
@click.option(
    "--name", "person", metavar="NAME", help="The person's name; stored outside the log, can be erased."
)
@click.option("--mail", metavar="ADDRESS", help="The mail address; stored outside the log, can be erased.")
@workcell_option
@asker_options
def add(
    name: str,
    service: bool,
    role: str | None,
    person: str | None,
    mail: str | None,
    workcell: str | None,
    asker: Asker,
) -> None:
    """Add a person or a program as a user of the lab."""
    if workcell and not role:
        raise click.UsageError("--workcell needs --role.")
    with lab_or_its_folder(asker.home) as client:
        by = asker.user
        is_first = not client.users()
        client.add_user(
            name, by, kind="service" if service else "person", role=role, scope=scope_of(workcell)
        )
        if person or mail:
            client.set_person(name, name=person, mail=mail)
        found = client.user(name)
    end_with_json(found)
    if is_first:
        click.echo(f"{name} is the admin of this lab. From now on only its users have access.")
    else:
        what = "a service account" if service else "a user"
        click.echo(f"{name} is {what} of this lab: {describe_roles(found['roles']) or 'may read'}.")
    next_step = f"token create LABEL --for {name}" if service else f"user password {name}"
    click.echo(f"Next: labos {next_step}")


@command.command("list")
@lab_and_json
def list_users(asker: Asker) -> None:
    """List all users, with their groups and roles."""
    with asker.lab() as client:
        found = client.users()
    end_with_json(found)
    show_table(("id", "kind", "group", "roles", "since"), [_row(user) for user in found])
    if not found:
        click.echo("There are no users: everybody with network access to this lab has all rights.", err=True)


@command.command("show")
@_id
@lab_and_json
def show(name: str, asker: Asker) -> None:
    """Show one user, with the roles of the user's group."""
    with asker.lab() as client:
        found = client.user(name)
        groups = {group["name"]: group for group in client.groups()}
    found["group_roles"] = groups.get(found["group"], {}).get("roles", {})
    end_with_json(found)
    lines = (
        ("id", name),
        ("kind", found["kind"] + (", disabled" if found["disabled"] else "")),
        ("since", show_time(found["since"])),
        ("roles", describe_roles(found["roles"])),
        ("group", found["group"]),
        ("roles of the group", describe_roles(found["group_roles"])),
    )
    for title, text in lines:
        click.echo(f"{title + ':':20}{text or 'none'}")


@command.command("disable")
@_id
@asker_options
def disable(name: str, asker: Asker) -> None:
    """Disable a user: withdraw all rights. The user's active and waiting runs continue, campaigns are paused.
    Users are never removed, because the log refers to them."""
    with asker.lab() as client:
        client.disable_user(name, asker.user)
        if wants_json():
            show_json(client.user(name))


@command.command("enable")
@_id
@asker_options
def enable(name: str, asker: Asker) -> None:
    """Enable a disabled user again."""
    with asker.lab() as client:
        client.enable_user(name, asker.user)
        if wants_json():
            show_json(client.user(name))


@command.command("password")
@_id
@lab_and_json
def password(name: str, asker: Asker) -> None:
    """Change a password. For your own, you need the present one. An admin, and the owner of the lab's folder
    on the lab's computer, can change the password of any user.

    The command asks on the terminal. Without a terminal, it reads lines of standard input: the present
    password (only for your own), then the new one. All sessions of the user end.
    """
    with lab_or_its_folder(asker.home) as client:
        present = ask_password("Your present password") if client.identity()["user"] == name else ""
        client.set_password(name, ask_password(f"New password of {name}", twice=True), present)
    report_done(f"{name} has a new password.", {"user": name, "password_set": True})


@command.command("name")
@_id
@click.option("--name", "person", metavar="NAME", help="The person's name.")
@click.option("--mail", metavar="ADDRESS", help="A mail address.")
@lab_and_json
def rename(name: str, person: str | None, mail: str | None, asker: Asker) -> None:
    """Record a user's name and mail address. They are stored outside the log. The log has only ids."""
    with lab_or_its_folder(asker.home) as client:
        client.set_person(name, name=person, mail=mail)
    report_done(f"Name and address of {name} are recorded.", {"user": name, "name": person, "mail": mail})


@command.command("erase")
@_id
@lab_and_json
def erase(name: str, asker: Asker) -> None:
    """Erase a user's personal data: name, address, password, tokens, sessions. Events stay in the log, with
    the user's id.

    The user still exists. Use `labos user disable` too if nobody may act with this id.
    """
    with lab_or_its_folder(asker.home) as client:
        client.erase_person(name)
    report_done(f"Personal data of {name} is erased. Only the id is left.", {"user": name, "erased": True})


@command.command("link")
@_id
@click.argument("issuer")
@click.argument("subject")
@lab_and_json
def link(name: str, issuer: str, subject: str, asker: Asker) -> None:
    """Link a user to an identity at an identity provider. ISSUER is the provider's URL, SUBJECT the user's
    identifier there.

    \b
    labos user link ada https://login.example.org 248289761001
    """
    with lab_or_its_folder(asker.home) as client:
        client.link_identity(name, issuer, subject)
    report_done(f"{subject} of {issuer} is {name}.", {"user": name, "issuer": issuer, "subject": subject})


def _row(user: dict[str, Any]) -> tuple[str, ...]:
    kind = user["kind"] + (", disabled" if user["disabled"] else "")
    return user["id"], kind, user["group"], describe_roles(user["roles"]), show_time(user["since"])
