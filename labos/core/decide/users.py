"""Users, groups and roles: who may use the lab, and with which permissions."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

from labos.core.decide._base import Command, Decision, Rejection, decides
from labos.core.decide.lookups import decides_about
from labos.core.ids import split_key
from labos.core.lab import WHOLE_LAB
from labos.core.registry import Event
from labos.core.shares import Group
from labos.core.state import LabState
from labos.core.users import (
    GroupAdded,
    GroupRemoved,
    Kind,
    MemberAdded,
    MemberRemoved,
    Role,
    RoleGranted,
    RoleRevoked,
    User,
    UserAdded,
    UserDisabled,
    UserEnabled,
    UserErased,
    group_subject,
    user_subject,
)

TAKEN = frozenset({"labos", "somebody", "application", "nobody", "shared", "person", "lab"})
"""Ids that could be confused with LabOS itself, or with nobody in particular."""

_ID = re.compile(r"[^\W_][\w.-]{0,63}")


class AddUser(Command, frozen=True):
    """Let a person, or a program or agent (``service``), use the lab. ``role`` is optional. The first user
    becomes an admin in any case."""

    user: str
    kind: Kind = "person"
    role: Role | None = None
    scope: str = WHOLE_LAB

    def list_parts(self) -> Sequence[Command]:
        return () if self.role is None else (GrantRole(user_subject(self.user), self.role, self.scope),)


class DisableUser(Command, frozen=True):
    user: str


class EnableUser(Command, frozen=True):
    user: str


class EraseUser(Command, frozen=True):
    """Record that the lab has erased the personal data of a user. ``by`` is the user, or an admin."""

    user: str
    by: str


class AddGroup(Command, frozen=True):
    group: str


class RemoveGroup(Command, frozen=True):
    """Remove a group; its roles are removed too."""

    group: str


class AddMember(Command, frozen=True):
    group: str
    user: str


class RemoveMember(Command, frozen=True):
    group: str
    user: str


class GrantRole(Command, frozen=True):
    """Give a user (``user:ID``) or a group (``group:NAME``) a role in a workcell, or in the whole lab
    (``*``)."""

    subject: str
    role: Role
    scope: str = WHOLE_LAB


class RevokeRole(Command, frozen=True):
    subject: str
    scope: str = WHOLE_LAB


@decides(AddUser)
def add_user(state: LabState, command: AddUser) -> Decision:
    known = state.users.known
    wrong = _check_id("user", command.user, list(known))
    if wrong:
        return wrong
    if known:
        wrong = _check_scope(state, command.scope)
        granted = () if command.role is None else (_grant(command.user, command.role, command.scope),)
        return wrong or [UserAdded(command.user, command.kind), *granted]
    if command.kind == "service":
        return Rejection(
            "first_user",
            f"The first user of a lab is its admin, and {command.user} is a service account.",
            "First add the person who will administer the lab.",
        )
    return [UserAdded(command.user, command.kind), _grant(command.user, "admin", WHOLE_LAB)]


def _grant(user: str, role: Role, scope: str) -> RoleGranted:
    return RoleGranted(user_subject(user), role, scope)


def _expect_user(state: LabState, command: Any) -> User | Rejection:
    return state.users.known.get(command.user) or refuse_unknown_user(command.user)


def _expect_group(state: LabState, command: Any) -> Group | Rejection:
    return state.shares.groups.get(command.group) or _refuse_unknown_group(command.group)


@decides_about(EraseUser, _expect_user)
def erase_user(state: LabState, command: EraseUser, user: User) -> Decision:
    return [UserErased(command.user)]


@decides_about(DisableUser, _expect_user)
def disable_user(state: LabState, command: DisableUser, user: User) -> Decision:
    if user.disabled:
        return []
    return _check_last_admin(state, command.user) or [UserDisabled(command.user)]


@decides_about(EnableUser, _expect_user)
def enable_user(state: LabState, command: EnableUser, user: User) -> Decision:
    return [UserEnabled(command.user)] if user.disabled else []


@decides(AddGroup)
def add_group(state: LabState, command: AddGroup) -> Decision:
    return _check_id("group", command.group, list(state.shares.groups)) or [GroupAdded(command.group)]


@decides_about(RemoveGroup, _expect_group)
def remove_group(state: LabState, command: RemoveGroup, group: Group) -> Decision:
    return _remove(state, command.group)


def _remove(state: LabState, group: str) -> Iterator[Event]:
    subject = group_subject(group)
    for scope in list(state.users.roles.get(subject, ())):
        yield RoleRevoked(subject, scope)
    yield GroupRemoved(group)


@decides_about(AddMember, _expect_group)
def add_member(state: LabState, command: AddMember, group: Group) -> Decision:
    if command.user not in state.users.known:
        return refuse_unknown_user(command.user)
    present = state.shares.group_of.get(command.user)
    if present == command.group:
        return []
    if present is not None:
        return Rejection(
            "two_groups",
            f"{command.user} is in the group {present}, and a user can be in only one group.",
            f"Take {command.user} out of it first: labos group member remove {present} {command.user}",
        )
    return [MemberAdded(command.group, command.user)]


@decides_about(RemoveMember, _expect_group)
def remove_member(state: LabState, command: RemoveMember, group: Group) -> Decision:
    is_member = state.shares.group_of.get(command.user) == command.group
    return [MemberRemoved(command.group, command.user)] if is_member else []


@decides(GrantRole)
def grant_role(state: LabState, command: GrantRole) -> Decision:
    wrong = _check_subject(state, command.subject) or _check_scope(state, command.scope)
    if wrong:
        return wrong
    if state.users.roles.get(command.subject, {}).get(command.scope) == command.role:
        return []
    kind, name = split_key(command.subject)
    if kind == "user" and command.scope == WHOLE_LAB:  # it replaces the role in the whole lab
        wrong = _check_last_admin(state, name)
    return wrong or [RoleGranted(command.subject, command.role, command.scope)]


@decides(RevokeRole)
def revoke_role(state: LabState, command: RevokeRole) -> Decision:
    if command.scope not in state.users.roles.get(command.subject, {}):
        return _check_subject(state, command.subject) or []
    kind, name = split_key(command.subject)
    last = _check_last_admin(state, name) if kind == "user" and command.scope == WHOLE_LAB else None
    return last or [RoleRevoked(command.subject, command.scope)]


def refuse_unknown_user(name: str) -> Rejection:
    return Rejection("no_user", f"There is no active user {name!r}.", "List them: labos user list")


def _refuse_unknown_group(name: str) -> Rejection:
    return Rejection("no_group", f"There is no group {name!r}.", "List them: labos group list")


def _check_id(what: str, name: str, known: list[str]) -> Rejection | None:
    if not _ID.fullmatch(name) or name.casefold() in TAKEN:
        return Rejection(
            "bad_id",
            f"{name!r} cannot be the id of a {what}.",
            "An id has 1 to 64 letters, digits, dots and hyphens, begins with a letter or digit, and "
            f"is not one of {', '.join(sorted(TAKEN))}.",
        )
    alike = next((other for other in known if other.casefold() == name.casefold()), None)
    if alike is not None:
        return Rejection("known", f"There is a {what} {alike!r} already.", "Choose another id.")
    return None


def _check_subject(state: LabState, subject: str) -> Rejection | None:
    kind, name = split_key(subject)
    if kind == "user":
        return None if name in state.users.known else refuse_unknown_user(name)
    if kind == "group":
        return None if name in state.shares.groups else _refuse_unknown_group(name)
    return Rejection("no_subject", f"A role cannot be given to {subject!r}.", "Write user:ID or group:NAME.")


def _check_scope(state: LabState, scope: str) -> Rejection | None:
    if scope == WHOLE_LAB or scope in state.lab.workcells:
        return None
    return Rejection(
        "no_workcell",
        f"This lab has no workcell {scope!r}.",
        f"Name one of {', '.join(state.lab.workcells) or 'none yet'}, or {WHOLE_LAB} for the whole lab.",
    )


def _check_last_admin(state: LabState, user: str) -> Rejection | None:
    """Why a user must stay an admin of the lab; None if there is another admin."""
    if state.users.list_admins() != [user]:
        return None
    return Rejection(
        "last_admin",
        f"{user} is the only admin of this lab.",
        "Make another person admin first: labos role grant OTHER admin",
    )
