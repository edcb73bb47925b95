"""Users, groups and roles: who may do what."""

from __future__ import annotations

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
from labos.errors import Forbidden
from labos.http.bodies import By
from labos.http.method import Method
from labos.http.operation import Call, Operation, list_operations
from labos.http.people import (
    Grant,
    GrantView,
    GroupList,
    GroupView,
    Membership,
    NewGroup,
    NewUser,
    Revocation,
    UserList,
    UserView,
    list_group_views,
    list_user_views,
    make_group_view,
    make_user_view,
)
from labos.http.queries import OfGroup, OfUser

_USER = {
    "id": "ada",
    "kind": "person",
    "disabled": False,
    "since": 1_700_000_000_000_000_000,
    "group": "chemistry",
    "roles": {"rpl": "operator"},
}
_GROUP = {"name": "chemistry", "weight": 1.0, "members": ["ada"], "roles": {"*": "submitter"}}


@Operation(
    route="GET /users",
    client=Method("users", take="users"),
    summary="List the users and their roles",
    needs="viewer",
    example_answer={"users": [_USER], "open": False},
)
def list_users(call: Call) -> UserList:
    state = call.kernel.state
    return UserList(list_user_views(state), state.users.is_open)


@Operation(
    route="POST /users",
    client=Method("add_user", take=None),
    summary="Add a user: a person or a program",
    needs="admin",
    status=201,
    problems=("refused",),
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


@Operation(
    route="GET /users/{user}",
    client=Method("user"),
    summary="Show a user and the user's roles",
    needs="viewer",
    example_answer=_USER,
)
def get_user(call: Call, path: OfUser) -> UserView:
    return make_user_view(call.kernel.state, path.user)


@Operation(
    route="POST /users/{user}/disable",
    client=Method("disable_user", take=None, repeat=True),
    summary="Disable a user",
    needs="admin",
    problems=("refused",),
    example={"by": "ada"},
    example_answer={**_USER, "disabled": True},
)
async def disable_user(call: Call, path: OfUser, body: By) -> UserView:
    """The user may no longer do anything. The user's runs continue; the user's campaigns are paused."""
    return await _change_user(call, DisableUser(path.user), body.by)


@Operation(
    route="POST /users/{user}/enable",
    client=Method("enable_user", take=None, repeat=True),
    summary="Enable a disabled user",
    needs="admin",
    problems=("refused",),
    example={"by": "ada"},
    example_answer=_USER,
)
async def enable_user(call: Call, path: OfUser, body: By) -> UserView:
    return await _change_user(call, EnableUser(path.user), body.by)


async def _change_user(call: Call, command: AddUser | DisableUser | EnableUser, by: str) -> UserView:
    await call.kernel.execute(command, by)
    return make_user_view(call.kernel.state, command.user)


@Operation(
    route="GET /groups",
    client=Method("groups", take="groups"),
    summary="Groups, their members and their roles",
    needs="viewer",
    example_answer={"groups": [_GROUP]},
)
def list_groups(call: Call) -> GroupList:
    return GroupList(list_group_views(call.kernel.state))


@Operation(
    route="POST /groups",
    client=Method("add_group", take=None),
    summary="Add a group",
    needs="admin",
    status=201,
    problems=("refused",),
    example={"group": "chemistry", "by": "ada"},
    example_answer={**_GROUP, "members": [], "roles": {}},
)
async def add_group(call: Call, body: NewGroup) -> GroupView:
    """The group has weight 1; a shares file may set another weight."""
    return await _change_group(call, AddGroup(body.group), body.group, body.by)


@Operation(
    route="POST /groups/{group}/remove",
    client=Method("remove_group", take=None),
    summary="Remove a group",
    needs="admin",
    problems=("refused",),
    example={"by": "ada"},
    example_answer={"groups": []},
)
async def remove_group(call: Call, path: OfGroup, body: By) -> GroupList:
    """Its members are then in no group, and its roles are removed. The answer lists the remaining groups."""
    await call.kernel.execute(RemoveGroup(path.group), body.by)
    return GroupList(list_group_views(call.kernel.state))


@Operation(
    route="POST /groups/{group}/members",
    client=Method("add_member", take=None, repeat=True),
    summary="Add a user to a group",
    needs="admin",
    problems=("refused",),
    example={"user": "ada", "by": "ada"},
    example_answer=_GROUP,
)
async def add_member(call: Call, path: OfGroup, body: Membership) -> GroupView:
    """A user can be in only one group."""
    return await _change_group(call, AddMember(path.group, body.user), path.group, body.by)


@Operation(
    route="POST /groups/{group}/members/remove",
    client=Method("remove_member", take=None, repeat=True),
    summary="Take a user out of a group",
    needs="admin",
    problems=("refused",),
    example={"user": "ada", "by": "ada"},
    example_answer={**_GROUP, "members": []},
)
async def remove_member(call: Call, path: OfGroup, body: Membership) -> GroupView:
    return await _change_group(call, RemoveMember(path.group, body.user), path.group, body.by)


async def _change_group(call: Call, command: Command, group: str, by: str) -> GroupView:
    await call.kernel.execute(command, by)
    return make_group_view(call.kernel.state, group)


@Operation(
    route="POST /roles/grant",
    client=Method("grant_role", take=None, repeat=True),
    summary="Give a user or a group a role",
    needs="admin",
    problems=("refused",),
    example={"subject": "user:ada", "role": "operator", "scope": "rpl", "by": "ada"},
    example_answer={"subject": "user:ada", "scope": "rpl", "role": "operator"},
)
async def grant_role(call: Call, body: Grant) -> GrantView:
    """It replaces the role that the user or group has there."""
    await call.kernel.execute(GrantRole(body.subject, body.role, body.scope), body.by)
    return GrantView(body.subject, body.scope, body.role)


@Operation(
    route="POST /roles/revoke",
    client=Method("revoke_role", take=None, repeat=True),
    summary="Take a role away",
    needs="admin",
    problems=("refused",),
    example={"subject": "user:ada", "scope": "rpl", "by": "ada"},
    example_answer={"subject": "user:ada", "scope": "rpl", "role": ""},
)
async def revoke_role(call: Call, body: Revocation) -> GrantView:
    """A user without a role may only look."""
    await call.kernel.execute(RevokeRole(body.subject, body.scope), body.by)
    return GrantView(body.subject, body.scope, "")


OPERATIONS = list_operations(globals(), "people")
