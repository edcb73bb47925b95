"""Users, and their permissions: roles in the whole lab or in a workcell.

Events contain only the ids of persons. Users are disabled, never removed, because the log refers to them. The
members of groups are stored with the groups' weights and quotas (``shares.py``): there is one kind of group.
"""

from __future__ import annotations

from typing import Literal

import msgspec

from labos.core.lab import WHOLE_LAB
from labos.core.registry import Event, event

Kind = Literal["person", "service"]
"""A service account is a program or an agent. It may act on behalf of a person."""

Role = Literal["viewer", "submitter", "operator", "admin"]

ROLES: tuple[Role, ...] = ("viewer", "submitter", "operator", "admin")
"""The roles from the lowest to the highest; each includes the permissions of those before it."""

NO_ROLE = 0
"""The rank of a user without a role: such a user has the permissions of a viewer."""


LABOS = "labos"
"""The name under which LabOS itself acts; modules act under their own names, which contain a slash. No user
may have this name."""

ON_BEHALF = " for "
"""The text between a service account and the person for whom it acts."""


def on_behalf(service: str, person: str) -> str:
    """The name in the log of a service account that acts for a person; it contains both names."""
    return f"{service}{ON_BEHALF}{person}"


def find_person(actor: str) -> str:
    """The user who counts as the author of a request: the actor itself. If a service account acts for a
    person, it is that person."""
    return actor.rpartition(ON_BEHALF)[2]


def rank(role: Role) -> int:
    return ROLES.index(role)


def user_subject(user: str) -> str:
    """The name of a user in roles."""
    return f"user:{user}"


def group_subject(group: str) -> str:
    """The name of a group in roles."""
    return f"group:{group}"


class UserEvent(Event, frozen=True):
    user: str

    def stream(self) -> str:
        return user_subject(self.user)


@event("user.added")
class UserAdded(UserEvent, frozen=True):
    """A user is added and may use the lab according to their roles. As soon as there is one user, only users
    may use the lab."""

    kind: Kind


@event("user.disabled")
class UserDisabled(UserEvent, frozen=True):
    """The user may no longer do anything; their runs and roles stay as they are."""


@event("user.enabled")
class UserEnabled(UserEvent, frozen=True):
    """A disabled user may act again."""


@event("user.erased")
class UserErased(UserEvent, frozen=True):
    """The lab has erased the user's name, address and means of signing in. The user's events remain; like
    this one, they contain only the id."""


class GroupEvent(Event, frozen=True):
    group: str

    def stream(self) -> str:
        return group_subject(self.group)


@event("group.added")
class GroupAdded(GroupEvent, frozen=True):
    """A group is added, with weight 1 and without members. A shares file that does not name it does not
    change it."""


@event("group.removed")
class GroupRemoved(GroupEvent, frozen=True):
    """A group is removed; its members are then in no group."""


@event("group.member_added")
class MemberAdded(GroupEvent, frozen=True):
    """A user who is in no group joins this group, and has a part in its share of the lab and its roles."""

    user: str


@event("group.member_removed")
class MemberRemoved(GroupEvent, frozen=True):
    user: str


@event("role.granted")
class RoleGranted(Event, frozen=True):
    """A user (``user:ID``) or all members of a group (``group:NAME``) have a role in a workcell, or in the
    whole lab (``*``). It replaces their previous role there."""

    STREAM = "subject"
    subject: str
    role: Role
    scope: str = WHOLE_LAB


@event("role.revoked")
class RoleRevoked(Event, frozen=True):
    STREAM = "subject"
    subject: str
    scope: str = WHOLE_LAB


class User(msgspec.Struct):
    """``since`` is the time at which the user was added (UTC ns)."""

    kind: Kind
    since: int
    disabled: bool = False

    @property
    def is_person(self) -> bool:
        """Whether it is a person who may act."""
        return self.kind == "person" and not self.disabled


class Users(msgspec.Struct):
    """``known`` is by id; ``roles`` by subject and scope. A lab without users is open: everybody who can
    reach it may do everything."""

    known: dict[str, User] = {}
    roles: dict[str, dict[str, Role]] = {}

    @property
    def is_open(self) -> bool:
        return not self.known

    def get(self, user: str) -> User | None:
        """A user who may act; None if there is no such user, or if the user is disabled."""
        found = self.known.get(user)
        return found if found is not None and not found.disabled else None

    def rank_role(self, user: str, group: str, cell: str) -> int:
        """The rank of a user's role in a workcell, of the user or of the user's group. ``cell`` is ``*`` for
        the whole lab, and empty for the best role anywhere."""
        best = NO_ROLE
        for subject in (user_subject(user), group_subject(group)) if group else (user_subject(user),):
            for scope, role in self.roles.get(subject, _NOTHING).items():
                if scope in (WHOLE_LAB, cell) or not cell:
                    best = max(best, ROLES.index(role))
        return best

    def list_admins(self) -> list[str]:
        """The persons who may act and have themselves the role of admin in the whole lab. At least one of
        them must stay."""
        return [
            name
            for name, user in self.known.items()
            if user.is_person and self.roles.get(user_subject(name), _NOTHING).get(WHOLE_LAB) == "admin"
        ]


_NOTHING: dict[str, Role] = {}


def fold_user_added(users: Users, event: UserAdded, at: int) -> None:
    users.known[event.user] = User(event.kind, at)


def fold_user_disabled(users: Users, event: UserDisabled | UserEnabled, at: int) -> None:
    users.known[event.user].disabled = isinstance(event, UserDisabled)


def fold_role_granted(users: Users, event: RoleGranted, at: int) -> None:
    users.roles.setdefault(event.subject, {})[event.scope] = event.role


def fold_role_revoked(users: Users, event: RoleRevoked, at: int) -> None:
    scopes = users.roles[event.subject]
    del scopes[event.scope]
    if not scopes:
        del users.roles[event.subject]
