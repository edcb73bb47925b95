"""``labos role``: the rights of users and groups."""

from __future__ import annotations

import click

from labos.cli._group import Suggesting
from labos.cli._options import Asker, asker_options, lab_and_json
from labos.cli._out import end_with_json, show_table
from labos.cli._people import role_choice, scope_of, subject_of, workcell_option
from labos.core.lab import WHOLE_LAB
from labos.core.users import group_subject, user_subject

_subject = click.argument("subject", metavar="USER|group:GROUP")


@click.group("role", cls=Suggesting, short_help="Manage roles: the rights of users and groups.")
def command() -> None:
    """Manage roles: the rights of users and groups, in the whole lab or in a workcell.

    \b
    viewer      may read; so may a user without a role
    submitter   may also submit, and change own runs, experiments, campaigns and labware
    operator    may also answer questions, load the bench, control modules, and change all runs
    admin       may also change workcells, shares, users and roles

    \b
    labos role grant bo operator --workcell rpl
    labos role grant group:chemistry submitter
    labos role revoke bo --workcell rpl
    labos role list
    """


@command.command("grant")
@_subject
@click.argument("role", type=role_choice)
@workcell_option
@asker_options
def grant(subject: str, role: str, workcell: str | None, asker: Asker) -> None:
    """Grant a role to a user or a group. It replaces their present role there."""
    with asker.lab() as client:
        client.grant_role(subject_of(subject), role, asker.user, scope=scope_of(workcell))
    end_with_json({"subject": subject_of(subject), "scope": scope_of(workcell), "role": role})


@command.command("revoke")
@_subject
@workcell_option
@asker_options
def revoke(subject: str, workcell: str | None, asker: Asker) -> None:
    """Revoke a granted role, in a workcell or in the whole lab."""
    with asker.lab() as client:
        client.revoke_role(subject_of(subject), asker.user, scope=scope_of(workcell))
    end_with_json({"subject": subject_of(subject), "scope": scope_of(workcell), "role": ""})


@command.command("list")
@lab_and_json
def list_roles(asker: Asker) -> None:
    """List all granted roles: to whom, and in which workcell or the whole lab."""
    with asker.lab() as client:
        users, groups = client.users(), client.groups()
    held = [(user_subject(user["id"]), user["roles"]) for user in users]
    held += [(group_subject(group["name"]), group["roles"]) for group in groups]
    grants = [(subject, scope, role) for subject, roles in held for scope, role in roles.items()]
    end_with_json([{"subject": subject, "scope": scope, "role": role} for subject, scope, role in grants])
    rows = [
        (role, subject.removeprefix(user_subject("")), "the whole lab" if scope == WHOLE_LAB else scope)
        for subject, scope, role in grants
    ]
    show_table(("role", "of", "in"), rows)
