"""Users, groups and roles, as the types of requests and answers."""

from __future__ import annotations

from typing import Annotated

import msgspec

from labos.core.lab import WHOLE_LAB
from labos.core.state import LabState
from labos.core.users import Kind, Role, group_subject, user_subject
from labos.errors import NotFound
from labos.http.bodies import By
from labos.http.limits import Name, says

Subject = Annotated[Name, says("`user:ID` or `group:NAME`")]
Scope = Annotated[Name, says("a workcell, or `*` for the whole lab")]


class NewUser(By, forbid_unknown_fields=True, kw_only=True):
    user: Annotated[Name, says("the id, not the person's name: events contain it permanently")]
    kind: Annotated[Kind, says("`person`, or `service` for a program or an agent")] = "person"
    role: Annotated[Role | None, says("the first role; the first user of a lab is admin in any case")] = None
    scope: Scope = WHOLE_LAB


class NewGroup(By, forbid_unknown_fields=True, kw_only=True):
    group: Annotated[Name, says("its name")]


class Membership(By, forbid_unknown_fields=True, kw_only=True):
    user: Annotated[Name, says("a user's id")]


class Grant(By, forbid_unknown_fields=True, kw_only=True):
    subject: Subject
    role: Annotated[Role, says("`viewer`, `submitter`, `operator` or `admin`")]
    scope: Scope = WHOLE_LAB


class Revocation(By, forbid_unknown_fields=True, kw_only=True):
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


def make_user_view(state: LabState, name: str) -> UserView:
    """Raises NotFound."""
    user = state.users.known.get(name)
    if user is None:
        raise NotFound(f"There is no user {name!r}.", remedy="List them: labos user list")
    roles = state.users.roles.get(user_subject(name), {})
    group = state.shares.group_of.get(name, "")
    return UserView(name, user.kind, user.disabled, user.since, group, dict(roles))


def list_groups(state: LabState) -> GroupList:
    return GroupList([make_group_view(state, name) for name in state.shares.groups])


def make_group_view(state: LabState, name: str) -> GroupView:
    """Raises NotFound."""
    group = state.shares.groups.get(name)
    if group is None:
        raise NotFound(f"There is no group {name!r}.", remedy="List them: labos group list")
    roles = state.users.roles.get(group_subject(name), {})
    return GroupView(name, group.weight, list(group.members), dict(roles))
