"""``labos group``: users who share a part of the lab and its roles."""

from __future__ import annotations

from typing import Any

import click

from labos.cli._group import Suggesting
from labos.cli._options import Asker, asker_options, lab_and_json
from labos.cli._out import end_with_json, show_table
from labos.cli._people import describe_roles

_name = click.argument("name", metavar="GROUP")
_member = click.argument("member", metavar="USER")


@click.group("group", cls=Suggesting, short_help="Manage groups of users, who share a part of the lab.")
def command() -> None:
    """Manage groups: users who share a part of the lab, with roles for all members.

    Weights and quotas of groups are set with a file: labos shares --apply. A user is in one group at most.

    \b
    labos group add chemistry
    labos group member add chemistry ada
    labos role grant group:chemistry submitter
    labos group list
    """


@command.command("add")
@_name
@asker_options
def add(name: str, asker: Asker) -> None:
    """Add a group with weight 1 and without members."""
    with asker.lab() as client:
        client.add_group(name, asker.user)
        _show_group(client.groups(), name)


@command.command("remove")
@_name
@asker_options
def remove(name: str, asker: Asker) -> None:
    """Remove a group and its roles. Its members are then in no group."""
    with asker.lab() as client:
        client.remove_group(name, asker.user)
    end_with_json({"group": name, "removed": True})


@command.command("list")
@lab_and_json
def list_groups(asker: Asker) -> None:
    """List all groups, with their weights, members and roles."""
    with asker.lab() as client:
        found = client.groups()
    end_with_json(found)
    rows = [
        (group["name"], f"{group['weight']:g}", ", ".join(group["members"]), describe_roles(group["roles"]))
        for group in found
    ]
    show_table(("group", "weight", "members", "roles"), rows)


@command.group("member", cls=Suggesting, short_help="Manage the members of a group.")
def members() -> None:
    """Manage the members of a group.

    \b
    labos group member add chemistry ada
    labos group member remove chemistry ada
    """


@members.command("add")
@_name
@_member
@asker_options
def add_member(name: str, member: str, asker: Asker) -> None:
    """Add a user to a group. The user gets the group's share of the lab and its roles."""
    with asker.lab() as client:
        client.add_member(name, member, asker.user)
        _show_group(client.groups(), name)


@members.command("remove")
@_name
@_member
@asker_options
def remove_member(name: str, member: str, asker: Asker) -> None:
    """Remove a user from a group."""
    with asker.lab() as client:
        client.remove_member(name, member, asker.user)
        _show_group(client.groups(), name)


def _show_group(groups: list[dict[str, Any]], name: str) -> None:
    end_with_json(next(group for group in groups if group["name"] == name))
