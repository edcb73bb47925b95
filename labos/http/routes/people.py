"""Users, groups and roles: who may do what."""

from __future__ import annotations

from typing import Annotated

import msgspec

from labos.core.decide import Command
from labos.core.decide.users import (
    AddGroup,
    AddMember,
    AddUser,
    DisableUser,
    EnableUser,
    GrantRole,
    RemoveGroup,
    RemoveMember,
    RevokeRole,
)
from labos.core.lab import WHOLE_LAB
from labos.core.state import LabState
from labos.core.users import Kind, Role, group_subject, user_subject
from labos.errors import Forbidden, NotFound
from labos.http.bodies import By
from labos.http.limits import Name, says
from labos.http.operation import Call, Method, administer, read
from labos.http.queries import OfGroup, OfUser

Subject = Annotated[Name, says("`user:ID` or `group:NAME`")]
Scope = Annotated[Name, says("a workcell, or `*` for the whole lab")]


class NewUser(By, kw_only=True):
    user: Annotated[Name, says("the id, not the person's name: events contain it permanently")]
    kind: Annotated[Kind, says("`person`, or `service` for a program or an agent")] = "person"
    role: Annotated[Role | None, says("the first role; the first user of a lab is admin in any case")] = None
    scope: Scope = WHOLE_LAB


class NewGroup(By, kw_only=True):
    group: Annotated[Name, says("its name")]


class Membership(By, kw_only=True):
    user: Annotated[Name, says("a user's id")]


class Grant(By, kw_only=True):
    subject: Subject
    role: Annotated[Role, says("`viewer`, `submitter`, `operator` or `admin`")]
    scope: Scope = WHOLE_LAB


class Revocation(By, kw_only=True):
    subject: Subject
    scope: Scope = WHOLE_LAB


class UserView(msgspec.Struct, frozen=True):
    """``since`` is in UTC nanoseconds. ``roles`` are the user's own, by workcell (``*``: the whole lab). The
    roles of the ``group`` (empty: none) are added to them."""

    id: str
    kind: Kind
    disabled: bool
    since: int
    group: str
    roles: dict[str, Role]


class GroupView(msgspec.Struct, frozen=True):
    """``weight`` sets its share of the lab; ``roles`` are by workcell (``*``: the whole lab)."""

    name: str
    weight: float
    members: list[str]
    roles: dict[str, Role]


class UserList(msgspec.Struct, frozen=True):
    """``open``: there are no users, and everybody who can reach the lab may do everything."""

    users: list[UserView]
    open: bool


class GroupList(msgspec.Struct, frozen=True):
    groups: list[GroupView]


class GrantView(msgspec.Struct, frozen=True):
    """The subject's present role; empty for none."""

    subject: str
    scope: str
    role: str


_USER = {
    "id": "ada",
    "kind": "person",
    "disabled": False,
    "since": 1_700_000_000_000_000_000,
    "group": "chemistry",
    "roles": {"rpl": "operator"},
}
_GROUP = {"name": "chemistry", "weight": 1.0, "members": ["ada"], "roles": {"*": "submitter"}}


@read(
    route="GET /users",
    client=Method("users", take="users"),
    summary="List the users and their roles",
    example_answer={"users": [_USER], "open": False},
)
def list_users(call: Call) -> UserList:
    state = call.kernel.state
    return UserList([_make_user_view(state, name) for name in state.users.known], state.users.is_open)


@administer(
    route="POST /users",
    client=Method("add_user", take=None),
    summary="Add a user: a person or a program",
    status=201,
    example={"user": "bo", "by": "ada"},
    example_answer={**_USER, "id": "bo", "roles": {}},
)
async def add_user(call: Call, body: NewUser) -> UserView:
    """As soon as there is one user, only users may do anything. The first user becomes admin of the whole
    lab. The owner of the lab's folder adds the first user, with the content of `home.key` as the token."""
    if call.kernel.state.users.is_open and call.who.how != "home":
        raise Forbidden(
            f"{body.user!r} would be the first user of this lab and its admin. Only the owner of the "
            "lab's folder can add this user.",
            remedy=f"On the lab's computer: labos user add {body.user} --home FOLDER",
        )
    return await _change_user(call, AddUser(body.user, body.kind, body.role, body.scope), body.by)


@read(
    route="GET /users/{user}",
    client=Method("user"),
    summary="Show a user and the user's roles",
    example_answer=_USER,
)
def get_user(call: Call, path: OfUser) -> UserView:
    return _make_user_view(call.kernel.state, path.user)


@administer(
    route="POST /users/{user}/disable",
    client=Method("disable_user", take=None, repeat=True),
    summary="Disable a user",
    example={"by": "ada"},
    example_answer={**_USER, "disabled": True},
)
async def disable_user(call: Call, path: OfUser, body: By) -> UserView:
    """The user may no longer do anything. The user's runs continue; the user's campaigns are paused."""
    return await _change_user(call, DisableUser(path.user), body.by)


@administer(
    route="POST /users/{user}/enable",
    client=Method("enable_user", take=None, repeat=True),
    summary="Enable a disabled user",
    example={"by": "ada"},
    example_answer=_USER,
)
async def enable_user(call: Call, path: OfUser, body: By) -> UserView:
    return await _change_user(call, EnableUser(path.user), body.by)


async def _change_user(call: Call, command: AddUser | DisableUser | EnableUser, by: str) -> UserView:
    await call.kernel.execute(command, by)
    return _make_user_view(call.kernel.state, command.user)


@read(
    route="GET /groups",
    client=Method("groups", take="groups"),
    summary="Groups, their members and their roles",
    example_answer={"groups": [_GROUP]},
)
def list_groups(call: Call) -> GroupList:
    return _list_groups(call.kernel.state)


@administer(
    route="POST /groups",
    client=Method("add_group", take=None),
    summary="Add a group",
    status=201,
    example={"group": "chemistry", "by": "ada"},
    example_answer={**_GROUP, "members": [], "roles": {}},
)
async def add_group(call: Call, body: NewGroup) -> GroupView:
    """The group has weight 1; a shares file may set another weight."""
    return await _change_group(call, AddGroup(body.group), body.group, body.by)


@administer(
    route="POST /groups/{group}/remove",
    client=Method("remove_group", take=None),
    summary="Remove a group",
    example={"by": "ada"},
    example_answer={"groups": []},
)
async def remove_group(call: Call, path: OfGroup, body: By) -> GroupList:
    """Its members are then in no group, and its roles are removed. The answer lists the remaining groups."""
    await call.kernel.execute(RemoveGroup(path.group), body.by)
    return _list_groups(call.kernel.state)


@administer(
    route="POST /groups/{group}/members",
    client=Method("add_member", take=None, repeat=True),
    summary="Add a user to a group",
    example={"user": "ada", "by": "ada"},
    example_answer=_GROUP,
)
async def add_member(call: Call, path: OfGroup, body: Membership) -> GroupView:
    """A user can be in only one group."""
    return await _change_group(call, AddMember(path.group, body.user), path.group, body.by)


@administer(
    route="POST /groups/{group}/members/remove",
    client=Method("remove_member", take=None, repeat=True),
    summary="Take a user out of a group",
    example={"user": "ada", "by": "ada"},
    example_answer={**_GROUP, "members": []},
)
async def remove_member(call: Call, path: OfGroup, body: Membership) -> GroupView:
    return await _change_group(call, RemoveMember(path.group, body.user), path.group, body.by)


async def _change_group(call: Call, command: Command, group: str, by: str) -> GroupView:
    await call.kernel.execute(command, by)
    return _make_group_view(call.kernel.state, group)


@administer(
    route="POST /roles/grant",
    client=Method("grant_role", take=None, repeat=True),
    summary="Give a user or a group a role",
    example={"subject": "user:ada", "role": "operator", "scope": "rpl", "by": "ada"},
    example_answer={"subject": "user:ada", "scope": "rpl", "role": "operator"},
)
async def grant_role(call: Call, body: Grant) -> GrantView:
    """It replaces the role that the user or group has there."""
    await call.kernel.execute(GrantRole(body.subject, body.role, body.scope), body.by)
    return GrantView(body.subject, body.scope, body.role)


@administer(
    route="POST /roles/revoke",
    client=Method("revoke_role", take=None, repeat=True),
    summary="Take a role away",
    example={"subject": "user:ada", "scope": "rpl", "by": "ada"},
    example_answer={"subject": "user:ada", "scope": "rpl", "role": ""},
)
async def revoke_role(call: Call, body: Revocation) -> GrantView:
    """A user without a role may only look."""
    await call.kernel.execute(RevokeRole(body.subject, body.scope), body.by)
    return GrantView(body.subject, body.scope, "")


def _make_user_view(state: LabState, name: str) -> UserView:
    """Raises NotFound."""
    user = state.users.known.get(name)
    if user is None:
        raise NotFound(f"There is no user {name!r}.", remedy="List them: labos user list")
    roles = state.users.roles.get(user_subject(name), {})
    group = state.shares.group_of.get(name, "")
    return UserView(name, user.kind, user.disabled, user.since, group, dict(roles))


def _list_groups(state: LabState) -> GroupList:
    return GroupList([_make_group_view(state, name) for name in state.shares.groups])


def _make_group_view(state: LabState, name: str) -> GroupView:
    """Raises NotFound."""
    group = state.shares.groups.get(name)
    if group is None:
        raise NotFound(f"There is no group {name!r}.", remedy="List them: labos group list")
    roles = state.users.roles.get(group_subject(name), {})
    return GroupView(name, group.weight, list(group.members), dict(roles))
